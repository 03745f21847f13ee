# SPDX-License-Identifier: Apache-2.0
"""Control laws by name: v-dPBC, and laws that other packages register (docs/compare.md)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainsError, ParameterError
from ..files.importing import is_named, load

if TYPE_CHECKING:
    from ..law.interfaces import StaticLaw

V_DPBC = "v_dpbc"
GROUP = "fjr.laws"


@dataclass(frozen=True)
class LawKind:
    """A control law by name.

    make: (robot, gains, compile=False) -> law. measures: the joint signals the law needs.
    tuning_rule: (robot, configuration (n,), natural frequency [rad/s], damping ratio, sample period [s]) -> gains;
    default_damping: ratio; damping_range: of the ratio. The gains of a law of the user are options: its rule raises.
    storage: description of V, "" if the law has no storage (V is nan). extension: what its paper does not have.
    scaled: gains, by their names, that `fjr tune` scales in addition to the two numbers of the rule.
    """

    name: str
    title: str
    paper: str
    make: Callable[..., StaticLaw]
    tuning_rule: Callable[..., Any]
    measures: str = "both sides"
    storage: str = "decays along every reference"
    default_damping: float = 0.7
    damping_range: tuple[float, float] = (0.5, 2.0)
    extension: str = ""
    scaled: tuple[str, ...] = ()

    def scale(self, gains: Any, factors: ArrayLike) -> Any:
        """Return the gains with those of `scaled` multiplied by factors: one for all, or one for each.

        Raises GainsError for another number of factors or one that is not positive.
        """
        given = np.ravel(np.asarray(factors, dtype=float))
        if len(given) not in (1, len(self.scaled)) or not np.all(given > 0):
            names = ", ".join(self.scaled) or "no gain"
            raise GainsError(f"the gain factors are {given.tolist()}; expected 1, or positive ones for {names}")
        each = zip(self.scaled, np.broadcast_to(given, len(self.scaled)), strict=True)
        return replace(gains, **{name: factor * np.asarray(getattr(gains, name)) for name, factor in each})


class Laws(Mapping[str, LawKind]):
    """The laws by name: v-dPBC, and those that other packages register as entry points of the group GROUP.

    An entry point names a tuple of LawKind; it is imported when a law other than v-dPBC is looked up or listed, and
    v-dPBC when it is looked up.
    """

    @cached_property
    def _v_dpbc(self) -> LawKind:
        from ..law.gains import two_scale_gains
        from ..law.vdpbc import TrackingLaw

        return LawKind(
            V_DPBC,
            "v-dPBC",
            "Reyes-Baez, van der Schaft, Jayawardhana 2018",
            TrackingLaw,
            two_scale_gains,
            default_damping=0.3,
            damping_range=(0.1, 0.5),
            scaled=("Lambda_l", "Pi_l", "K_ld", "Lambda_m", "Pi_m", "K_md"),
        )

    @cached_property
    def _all(self) -> dict[str, LawKind]:
        from importlib.metadata import entry_points  # here, because v-dPBC needs none

        registered = (kind for point in entry_points(group=GROUP) for kind in point.load())
        return {V_DPBC: self._v_dpbc, **{kind.name: kind for kind in registered}}

    def __getitem__(self, name: str) -> LawKind:
        return self._v_dpbc if name == V_DPBC else self._all[name]

    def __contains__(self, name: object) -> bool:
        return name == V_DPBC or name in self._all

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)

    def __bool__(self) -> bool:
        return True


LAWS = Laws()


def law_kind(name: str) -> LawKind:
    """Return the law of this name, also of a class module:Class; raise ParameterError if unknown."""
    if not is_named(name):
        if name not in LAWS:
            raise ParameterError(f"law is {name!r}; expected one of {', '.join(LAWS)}")
        return LAWS[name]
    from .python_code import own_law

    own = load(name)
    storage = "given by the law" if hasattr(own, "storage") else ""

    def not_tuned(*_: Any) -> Any:
        raise GainsError(f"{own.__name__} has no tuning rule; expected its options instead")

    return LawKind(name, own.__name__, "law of the user", partial(own_law, name), not_tuned, storage=storage)
