# SPDX-License-Identifier: Apache-2.0
"""One float array of a message that is sent again and again, written in place."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray


class ArrayField:
    """A float array field of a message that is written in place."""

    def __init__(self, message: Any, name: str) -> None:
        self._message, self._name = message, name
        self._values: NDArray[np.float64] | None = None

    def fill(self, values: NDArray[np.float64] | None) -> None:
        """Write the values (k,), or leave the field empty for None."""
        own = self._values
        if values is None:
            if own is not None:
                setattr(self._message, self._name, array("d"))
                self._values = None
            return
        if own is None or len(own) != len(values):
            setattr(self._message, self._name, array("d", bytes(8 * len(values))))
            own = self._values = np.frombuffer(getattr(self._message, self._name))
        own[:] = values
