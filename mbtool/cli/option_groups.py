"""Lets a command get several options as one object."""

# typer makes an option from each parameter of a function. A parameter whose type is a subclass of
# OptionGroup stands for all fields of that class: each field becomes an option, and the command
# gets one object with their values. A field may be a group itself.

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, fields
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Annotated, Any, ClassVar, get_args, get_type_hints

from typer.models import OptionInfo


@dataclass(frozen=True, slots=True)
class OptionGroup:
    """Base class of groups of options. A subclass has one field for each option.

    A field is annotated like a parameter of a command, and has a default. In the help, `heading`
    stands above the group's options.
    """

    heading: ClassVar[str] = "Options"


def with_option_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with each parameter of type OptionGroup replaced by its options."""
    types = get_type_hints(command, include_extras=True)
    groups: dict[str, type[OptionGroup]] = {}
    parameters: list[Parameter] = []
    for parameter in signature(command).parameters.values():
        type_ = types[parameter.name]
        if _is_group(type_):
            groups[parameter.name] = type_
            parameters += _parameters_of(type_)
        else:
            parameters.append(parameter.replace(annotation=type_, kind=Parameter.KEYWORD_ONLY))

    @wraps(command)
    def ungrouped(**values: Any) -> None:
        objects = {name: _made(group, values) for name, group in groups.items()}
        command(**values, **objects)

    # typer reads the signature, and looks up annotations only if the function has any.
    ungrouped.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    ungrouped.__annotations__ = {}
    return ungrouped


def _made(group: type[OptionGroup], values: dict[str, Any]) -> OptionGroup:
    """Make a group of its values, which are taken out of `values`."""
    types = get_type_hints(group)
    return group(
        **{
            field.name: _made(types[field.name], values)
            if _is_group(types[field.name])
            else values.pop(field.name)
            for field in fields(group)
        }
    )


def _is_group(type_: Any) -> bool:
    return isinstance(type_, type) and issubclass(type_, OptionGroup)


def _parameters_of(group: type[OptionGroup]) -> list[Parameter]:
    types = get_type_hints(group, include_extras=True)
    parameters = []
    for field in fields(group):
        type_ = types[field.name]
        if _is_group(type_):
            parameters += _parameters_of(type_)
        else:
            annotation = _under(_heading(group, field.name), type_)
            parameters.append(
                Parameter(
                    field.name, Parameter.KEYWORD_ONLY, default=field.default, annotation=annotation
                )
            )
    return parameters


def _heading(group: type[OptionGroup], name: str) -> str:
    """Return the heading of the class that defines the field, which may be a base of the group."""
    owner = next(one for one in group.__mro__ if name in vars(one).get("__annotations__", ()))
    return owner.heading if issubclass(owner, OptionGroup) else group.heading


def _under(heading: str, annotation: Any) -> Any:
    """Return the annotation with `heading` above its option in the help, unless it has one."""
    type_, *rest = get_args(annotation)
    options = [copy(one) for one in rest]
    for option in options:
        if isinstance(option, OptionInfo) and option.rich_help_panel is None:
            option.rich_help_panel = heading
    return Annotated[(type_, *options)]
