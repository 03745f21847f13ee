# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: command line, declaration, descriptors, check, changes while it runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, ClassVar

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterType, SetParametersResult
from rclpy.lifecycle import LifecycleNode
from rclpy.parameter import Parameter as RosParameter

from fjr_core import FjrError, ParameterError
from fjr_core.config import ros_yaml
from fjr_core.config.nodes import OwnParameters, is_of_others, refuse, resolve
from fjr_core.config.parameter import Parameter, Value, unread_options

from .participant import exchange_as_processes_do
from .process import LONGEST, EndingNode

_TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
}
_LIST_TYPES = {float: ParameterType.PARAMETER_DOUBLE_ARRAY, str: ParameterType.PARAMETER_STRING_ARRAY}


def descriptor(parameter: Parameter, managed: bool) -> ParameterDescriptor:
    """Return the ROS descriptor of a parameter; managed: of a lifecycle node."""
    read_only = not parameter.dynamic and not managed
    description = f"{parameter.description} [{parameter.unit}]" if parameter.unit else parameter.description
    message = ParameterDescriptor(name=parameter.name, description=description, read_only=read_only)
    kind = type(parameter.default)
    message.type = _LIST_TYPES[type(parameter.default[0])] if isinstance(parameter.default, tuple) else _TYPES[kind]
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
        return f"one of {parameter.listed_choices}"
    if parameter.infinite:
        least = f"at least {parameter.minimum}, " if math.isfinite(parameter.minimum) else ""
        return f"{least}infinite for none"
    if math.isfinite(parameter.minimum) and not math.isfinite(parameter.maximum):
        return f"finite, at least {parameter.minimum}"
    example = parameter.default[0] if isinstance(parameter.default, tuple) else parameter.default
    return parameter.constraint or ("finite" if isinstance(example, float) else "")


_SIM_TIME = "use_sim_time"
_FOREIGN = (_SIM_TIME, "start_type_description_service", "qos_overrides.")


class ParameterNode(EndingNode):
    """A node whose parameters are declared in fjr_core.config; `values` holds the checked values.

    Given values override the robot file that they name, and the robot file overrides defaults. File paths are
    relative to the current directory. Names of other nodes' parameters are ignored, so that one file serves all nodes;
    an unknown name is an error. It is logged if a file gives it to all nodes and it resembles no known name.
    While the node runs, dynamic parameters change all together or not at all (`changed`). Other parameters, and
    use_sim_time, change only while a managed node is unconfigured (`is_open`); `recheck` then reads all of them.
    Raises ParameterError for an invalid value, unless the node `may_wait` for a valid one, and for a `-p` of the
    command line that a parameter file overrides.
    """

    managed: ClassVar[bool] = False
    """Whether the node can be unconfigured again."""
    _parameters_by_name: Mapping[str, Parameter] = {}
    fault: ParameterError | None = None
    """The error in the parameters of a node that waits for valid ones."""

    def __init__(self, name: str, own: OwnParameters, **node_kwargs: Any) -> None:
        """Declare the parameters and `build` the node.

        own: plant_parameters or controller_parameters of fjr_core.config; node_kwargs: as of rclpy's Node.
        """
        try:
            super().__init__(
                name,
                automatically_declare_parameters_from_overrides=True,
                allow_undeclared_parameters=True,
                **node_kwargs,
            )
        except ValueError as error:  # rclpy cannot declare a list without entries
            raise ParameterError(f"a parameter is an empty list; expected at least one entry ({error})") from None
        exchange_as_processes_do()
        self.guard_services()
        self._own = own
        self._given = self._taken_over()
        self._declaring = False
        self.values = {}
        arguments = node_kwargs.get("cli_args") or self.process_arguments
        self._for_any_node, unused = read_files(arguments, self.get_fully_qualified_name())
        for sentence in unused:
            self.get_logger().warning(sentence)
        try:
            values = {**self._given, _SIM_TIME: self.get_parameter(_SIM_TIME).value}
            if sentence := overruled(arguments, self.get_name(), values):
                raise ParameterError(sentence)
            self._read()
            self.add_on_set_parameters_callback(self._on_set)
            self.build()
        except Exception:
            self.destroy_node()  # remove the node from the graph at once
            raise

    def build(self) -> None:
        """Create publishers, subscriptions and components from the checked values; raises FjrError."""

    def may_wait(self) -> bool:
        """Return True if the node keeps running with invalid parameters until they are corrected."""
        return False

    def is_open(self) -> bool:
        """Return True if every parameter may change now; `recheck` checks them later."""
        return False

    def changed(self, values: dict[str, Any], names: set[str]) -> None:
        """Apply the complete new values, of which `names` were set; an FjrError rejects all of them."""

    def get_parameter_type(self, name: str) -> int:
        """Return the type of a parameter as a number; rclpy's Node returns an Enum for a name that is not declared."""
        found = super().get_parameter_type(name)
        return int(getattr(found, "value", found))

    def set_parameters(self, parameter_list: list[RosParameter]) -> list[SetParametersResult]:
        """Set parameters one by one, as rclpy's Node does; the present value of a parameter is always accepted."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[RosParameter]) -> SetParametersResult:
        """Set parameters together, as rclpy's Node does; the present value of a parameter is always accepted."""
        new = [
            p
            for p in parameter_list
            if not self.has_parameter(p.name) or not same_value(self.get_parameter(p.name).value, p.value)
        ]
        return super().set_parameters_atomically(new) if new else SetParametersResult(successful=True)

    def _taken_over(self) -> dict[str, Any]:
        """Return the given parameters; undeclare those that only other nodes have."""
        declared = self.get_parameters_by_prefix("")
        given = {name: parameter.value for name, parameter in declared.items() if not name.startswith(_FOREIGN)}
        for name in [name for name in given if is_of_others(self._own, name)]:
            self.undeclare_parameter(name)
            del given[name]
        return given

    def recheck(self) -> None:
        """Read all parameters again, including values set since; raises ParameterError and keeps the old values."""
        self.values = self._checked_values()
        self.fault = None

    def _read(self) -> None:
        try:
            self.values = self._checked_values()
        except ParameterError as error:
            if not self.may_wait():
                raise
            self.fault = error
            for name, value in self._given.items():  # with dynamic typing, so that a value of another type replaces it
                self.undeclare_parameter(name)
                described = ParameterDescriptor(dynamic_typing=True)
                self.declare_parameter(name, value, described, ignore_override=True)

    def _checked_values(self) -> dict[str, Any]:
        found = resolve(self._own, self._given, self.get_name(), Path.cwd(), self._for_any_node)
        for name in found.ignored:
            self.get_logger().warning(f"parameter '{name}' is ignored: this node does not have it")
        self._parameters_by_name = {parameter.name: parameter for parameter in found.declared}
        self._declaring = True
        try:
            for parameter in found.declared:  # in place of an earlier declaration
                name, value = parameter.name, found.values[parameter.name]
                if self.has_parameter(name):
                    self.undeclare_parameter(name)
                listed = list(value) if isinstance(value, tuple) else value
                self.declare_parameter(name, listed, descriptor(parameter, self.managed), ignore_override=True)
        finally:
            self._declaring = False
        return found.values

    @property
    def _when_open(self) -> str:
        return "while the node is unconfigured" if self.managed else "before the node starts"

    def _on_set(self, parameters: list[RosParameter]) -> SetParametersResult:
        if self._declaring:
            return SetParametersResult(successful=True)
        new = {p.name: p.value for p in parameters if not p.name.startswith(_FOREIGN)}
        try:
            clock = self.get_parameter(_SIM_TIME).value  # for which the node is built
            if not self.is_open() and any(p.name == _SIM_TIME and p.value != clock for p in parameters):
                raise ParameterError(f"parameter '{_SIM_TIME}' can be set only {self._when_open}")
            if new and self.is_open():  # an option may be of a class that is named before the next `recheck`
                options = unread_options(self._parameters_by_name.values(), new, user_code=False)
                if self._parameters_by_name:
                    refuse(self._own, self._parameters_by_name, new.keys() - options)
            elif new:
                values = {**self.values, **self._checked_change(new)}
                self.changed(values, set(new))
                self.values = values
        except FjrError as error:
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        self._given = {name: value for name, value in (self._given | new).items() if value is not None}  # None: deleted
        return SetParametersResult(successful=True)

    def _checked_change(self, new: Mapping[str, object]) -> dict[str, Value]:
        """Return the set values, checked one by one; raises ParameterError for a parameter that may not change now."""
        refuse(self._own, self._parameters_by_name, new)
        for name in new:
            if not self._parameters_by_name[name].dynamic:
                raise ParameterError(f"parameter '{name}' can be set only {self._when_open}")
        return {name: self._parameters_by_name[name].check(value) for name, value in new.items()}


class ManagedParameterNode(ParameterNode, LifecycleNode):
    """A managed (lifecycle) node with checked parameters.

    A request of a transition that the present state does not have is refused with one sentence in the log.
    """

    managed = True

    def guard_services(self) -> None:
        """Guard the services that rclpy creates by itself, and refuse transitions that are not possible now."""
        service = self._service_change_state
        change = service.callback

        def on_request(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            asked = request.transition
            possible = {number: label for number, label, *_ in self._state_machine.available_transitions}
            if asked.label in possible.values() if asked.label else asked.id in possible:
                return change(request, response)
            state, choices = self._state_machine.current_state[1], ", ".join(possible.values()) or "none"
            what = repr(asked.label[:LONGEST]) if asked.label else asked.id
            self.get_logger().warning(f"transition is {what} in the state {state}; expected one of {choices}")
            response.success = False
            return response

        service.callback = on_request
        super().guard_services()

    def destroy_node(self) -> None:
        """Destroy the node and its state machine, which rclpy leaves to the collector, with the node in the graph."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()


# The command line. rcl puts `-p name:=value` into the section /** and merges it with the parameter files in the order
# of the command line. A later section, such as /**/node of a file, overrides /**.


_FLAGS = ("-p", "--param")


@dataclass(frozen=True)
class ParameterRule:
    """One `-p [node:]name:=value`; node is "" for all nodes, value is parsed as by rcl."""

    node: str
    name: str
    value: Any
    text: str


def parameter_rules(arguments: Sequence[str]) -> Iterator[ParameterRule]:
    """Yield the rules between `--ros-args` and `--` in their order; rules that rcl rejects are left out."""
    inside, flag = False, ""
    for argument in arguments:
        if flag in _FLAGS:
            flag, (target, separator, value) = "", argument.partition(":=")
            node, _, name = target.rpartition(":")
            with suppress(ParameterError):
                if separator:
                    yield ParameterRule(node, name, ros_yaml.parse(value), argument)
        elif argument in ("--ros-args", "--"):
            inside = argument == "--ros-args"
        elif inside:
            flag = argument


def read_files(arguments: Sequence[str], node: str) -> tuple[set[str], list[str]]:
    """Return the names that parameter files give to all nodes, and a sentence for each without a section of /node."""
    found, unused = set[str](), list[str]()
    for file in (file for flag, file in zip(arguments, arguments[1:], strict=False) if flag == "--params-file"):
        with suppress(ParameterError):  # rcl reports a file that it cannot read
            content = read if isinstance(read := ros_yaml.read(Path(file), "parameter file"), dict) else {}
            found |= ros_yaml.values_for(ros_yaml.SHARED, content).keys()
            own = [name if "ros__parameters" in (below or ()) else f"{name}/**" for name, below in content.items()]
            if not any(fnmatchcase(node, f"/{name}".replace("//", "/").replace("/**", "*")) for name in own):
                seen = ", ".join(own) or "it has no sections"
                unused.append(f"{file} has no section of {node} ({seen}); expected {ros_yaml.SHARED} or /**{node}")
    return found, unused


def overruled(arguments: Sequence[str], node: str, values: Mapping[str, Any]) -> str:
    """Return one sentence about the first rule for `node` that has no effect on its `values`, or "".

    The last of several rules for one name counts.
    """
    rules = [rule for rule in parameter_rules(arguments) if rule.node in ("", node)]
    last = {rule.name: rule for rule in rules}
    for name, rule in last.items():
        if name in values and not same_value(rule.value, values[name]):
            return (
                f"argument '-p {rule.text}' has no effect: a parameter file sets {name} to {_listed(values[name])!r}; "
                "expected -p after --params-file, and the file's value in the section /** (-p reaches no other)"
            )
    return ""


def same_value(one: Any, other: Any) -> bool:
    """Return True if two parameter values are equal in type and value; nan equals nan."""
    return repr(_listed(one)) == repr(_listed(other))


def _listed(value: Any) -> Any:
    return value if value is None or isinstance(value, (bool, int, float, str)) else list(value)
