# SPDX-License-Identifier: Apache-2.0
"""A node's parameters from their table in fjr_core.config.builders, with descriptors, units and ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterType, SetParametersResult
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter as RosParameter

from fjr_core import FjrError, ParameterError
from fjr_core.config import builders, robot_file
from fjr_core.config.parameter import Parameter, Value, complete, unknown

from .command_line import overruled, same_value
from .failure import EndingNode

_SIM_TIME = "use_sim_time"
_FOREIGN = (_SIM_TIME, "start_type_description_service", "qos_overrides.")

_TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
}
_LIST_TYPES = {float: ParameterType.PARAMETER_DOUBLE_ARRAY, str: ParameterType.PARAMETER_STRING_ARRAY}


class CheckedParameters(EndingNode):
    """Mixin of a node whose parameters are a table of fjr_core.config.builders; `values` holds them, checked.

    Given values win over those of the robot file that they name, and these over defaults; paths of files are
    relative to the current directory. A name that no parameter has is reported and ignored; names of other nodes'
    parameters are ignored, so that one file serves all nodes.
    While the node runs, dynamic parameters change all together or not at all (`changed`); the others do not
    change, except in a managed node that is unconfigured (`is_open`), which reads all again by `recheck`.
    Raises ParameterError for a value that does not fit, unless the node `may_wait` for a better one, and for a `-p` of
    the command line that a parameter file overrules.
    use_sim_time changes only while `is_open`: what is built follows one clock.
    """

    values: dict[str, Any]
    fault: ParameterError | None = None
    """Why the parameters do not fit, of a node that waits for better ones."""
    process_arguments: ClassVar[Sequence[str]] = ()
    """The command line of the process, where it was given to rclpy.init."""

    def __init__(self, name: str, own: builders.OwnParameters, **node_kwargs: Any) -> None:
        """own: plant_parameters or controller_parameters of fjr_core.config; node_kwargs: as rclpy's Node."""
        try:
            super().__init__(
                name,
                automatically_declare_parameters_from_overrides=True,
                allow_undeclared_parameters=True,
                **node_kwargs,
            )
        except ValueError as error:  # rclpy cannot declare a list without entries
            raise ParameterError(f"a parameter is an empty list; expected at least one entry ({error})") from None
        self._own = own
        self._given = self._taken_over()
        self._declaring = False
        self.values = {}
        try:
            self._refuse_overruled(node_kwargs.get("cli_args") or self.process_arguments)
            self._read()
            self.add_on_set_parameters_callback(self._on_set)
            self.build()
        except Exception:
            self.destroy_node()  # a node that cannot be built leaves the graph at once
            raise

    def build(self) -> None:
        """Make publishers, subscriptions and the rest from the checked values; raises FjrError."""

    def may_wait(self) -> bool:
        """Whether the node lives on with parameters that do not fit, until they are mended."""
        return False

    def is_open(self) -> bool:
        """Whether every parameter may change now, to be checked later by `recheck`."""
        return False

    def changed(self, values: dict[str, Any], names: set[str]) -> None:
        """Take over the complete new values, of which `names` were set; an FjrError refuses them all."""

    def given(self, name: str, default: Any) -> Any:
        """A parameter as it was given, unchecked."""
        return self._given.get(name, default)

    def set_parameters(self, parameter_list: list[RosParameter]) -> list[SetParametersResult]:
        """As of rclpy's Node; a value that a parameter already has is always accepted."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[RosParameter]) -> SetParametersResult:
        """As of rclpy's Node; a value that a parameter already has is always accepted."""
        new = [parameter for parameter in parameter_list if not self._has(parameter)]
        return super().set_parameters_atomically(new) if new else SetParametersResult(successful=True)

    def _has(self, parameter: RosParameter) -> bool:
        name = parameter.name
        return bool(self.has_parameter(name)) and same_value(self.get_parameter(name).value, parameter.value)

    def _taken_over(self) -> dict[str, Any]:
        """Return the parameters that were given; those that only other nodes have are dropped."""
        given = {
            name: self.get_parameter(name).value
            for name in self.get_parameters_by_prefix("")
            if not name.startswith(_FOREIGN)
        }
        for name in given.keys() & builders.names_of_others(self._own):
            self.undeclare_parameter(name)
            del given[name]
        return given

    def _refuse_overruled(self, arguments: Sequence[str]) -> None:
        """Raise ParameterError for a `-p` that a parameter file overrules."""
        values = {**self._given, _SIM_TIME: self.get_parameter(_SIM_TIME).value}
        sentence = overruled(arguments, self.get_name(), values)
        if sentence:
            raise ParameterError(sentence)

    def recheck(self) -> None:
        """Read all parameters again, with what was set since; raises ParameterError and keeps the old values."""
        self.values = self._checked_values()
        self.fault = None

    def _read(self) -> None:
        try:
            self.values = self._checked_values()
        except ParameterError as error:
            if not self.may_wait():
                raise
            self.fault = error
            self._declare_bare()

    def _checked_values(self) -> dict[str, Any]:
        given = robot_file.merged(self._given, self.get_name(), Path.cwd())
        parameters = builders.all_parameters(self._own, given)
        for sentence in unknown(parameters, given):
            self.get_logger().warning(sentence)
        values = dict(complete(parameters, given))
        self._parameters_by_name = {parameter.name: parameter for parameter in parameters}
        self._declaring = True
        try:
            for parameter in parameters:
                self._declare(parameter, values[parameter.name])
        finally:
            self._declaring = False
        return values

    def _declare(self, parameter: Parameter, value: Value) -> None:
        """Declare a parameter with its descriptor, in place of an earlier or a bare one."""
        if self.has_parameter(parameter.name):
            self.undeclare_parameter(parameter.name)
        listed = list(value) if isinstance(value, tuple) else value
        described = descriptor(parameter, self._managed)
        self.declare_parameter(parameter.name, listed, described, ignore_override=True)

    def _declare_bare(self) -> None:
        """Declare what was given as it is, so that a value of any type can take its place."""
        for name, value in self._given.items():
            self.undeclare_parameter(name)
            self.declare_parameter(name, value, ParameterDescriptor(dynamic_typing=True), ignore_override=True)

    @property
    def _managed(self) -> bool:
        """Whether the node can be unconfigured again."""
        return isinstance(self, LifecycleNode)

    @property
    def _when_open(self) -> str:
        return "while the node is unconfigured" if self._managed else "before the node starts"

    def _on_set(self, parameters: list[RosParameter]) -> SetParametersResult:
        if self._declaring:
            return SetParametersResult(successful=True)
        new = {p.name: p.value for p in parameters if not p.name.startswith(_FOREIGN)}
        try:
            self._check_clock(parameters)
            if new and self.is_open():
                self._refuse_unknown(new)
            elif new:
                values = {**self.values, **self._checked_change(new)}
                self.changed(values, set(new))
                self.values = values
        except FjrError as error:
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        self._given |= new
        return SetParametersResult(successful=True)

    def _check_clock(self, parameters: list[RosParameter]) -> None:
        """Raise ParameterError for another use_sim_time than the one that the node is built for."""
        built_for = self.get_parameter(_SIM_TIME).value
        if not self.is_open() and any(p.name == _SIM_TIME and p.value != built_for for p in parameters):
            raise ParameterError(f"parameter '{_SIM_TIME}' can be set only {self._when_open}")

    def _checked_change(self, new: Mapping[str, object]) -> dict[str, Value]:
        """The values that are set, checked one by one; raises ParameterError for one that may not change now."""
        self._refuse_unknown(new)
        for name in new:
            if not self._parameters_by_name[name].dynamic:
                raise ParameterError(f"parameter '{name}' can be set only {self._when_open}")
        return {name: self._parameters_by_name[name].check(value) for name, value in new.items()}

    def _refuse_unknown(self, new: Mapping[str, object]) -> None:
        known = getattr(self, "_parameters_by_name", None)
        for sentence in unknown(list(known.values()), new) if known else ():
            raise ParameterError(sentence.replace(" is ignored", ""))


class ParameterNode(CheckedParameters):
    """A plain node with checked parameters."""


class ManagedParameterNode(CheckedParameters, LifecycleNode):
    """A managed (lifecycle) node with checked parameters."""

    def destroy_node(self) -> None:
        """As of rclpy's Node, which leaves the state machine, and with it the node in the graph, to the collector."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()


def descriptor(parameter: Parameter, managed: bool) -> ParameterDescriptor:
    """Return the ROS descriptor of a parameter, which says when it may change; managed: of a lifecycle node."""
    read_only = not parameter.dynamic and not managed
    message = ParameterDescriptor(name=parameter.name, description=_description(parameter), read_only=read_only)
    kind = type(parameter.default)
    if isinstance(parameter.default, tuple):
        message.type = _LIST_TYPES[type(parameter.default[0])]
    else:
        message.type = _TYPES[kind]
    bounded = math.isfinite(parameter.minimum) and math.isfinite(parameter.maximum)
    if kind is float and bounded:
        message.floating_point_range = [FloatingPointRange(from_value=parameter.minimum, to_value=parameter.maximum)]
    if kind is int and bounded:
        message.integer_range = [IntegerRange(from_value=int(parameter.minimum), to_value=int(parameter.maximum))]
    message.additional_constraints = "; ".join(filter(None, [_constraints(parameter), _when(parameter, managed)]))
    return message


def _when(parameter: Parameter, managed: bool) -> str:
    if parameter.dynamic:
        return "may change while the node is active" if managed else "may change while the node runs"
    return "may change only while the node is unconfigured" if managed else "fixed while the node runs"


def _constraints(parameter: Parameter) -> str:
    if parameter.choices:
        return f"one of {', '.join(parameter.choices)}"
    if parameter.infinite:
        least = f"at least {parameter.minimum}, " if math.isfinite(parameter.minimum) else ""
        return f"{least}infinite for none"
    if math.isfinite(parameter.minimum) and not math.isfinite(parameter.maximum):
        return f"finite, at least {parameter.minimum}"
    example = parameter.default[0] if isinstance(parameter.default, tuple) else parameter.default
    return parameter.constraint or ("finite" if isinstance(example, float) else "")


def _description(parameter: Parameter) -> str:
    return f"{parameter.description} [{parameter.unit}]" if parameter.unit else parameter.description
