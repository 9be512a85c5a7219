"""Lets the reference show records as they are made: with all their fields, and what these are by default."""

from typing import Any

from griffe import Class, Extension, Function, Parameter, ParameterKind, Parameters

__all__ = ["Records"]


class Records(Extension):
    """Gives each NamedTuple the `__init__` that Python makes for it, as griffe does for dataclasses."""

    def on_class(self, *, cls: Class, **_: Any) -> None:
        """Adds it to a class."""
        if "NamedTuple" not in map(str, cls.bases):
            return
        fields = [field for field in cls.attributes.values() if field.annotation and "property" not in field.labels]
        kind = ParameterKind.positional_or_keyword
        parameters = Parameters(
            Parameter("self", kind=kind),
            *(Parameter(field.name, annotation=field.annotation, kind=kind, default=field.value) for field in fields),
        )
        cls.set_member("__init__", Function("__init__", parameters=parameters, returns="None", parent=cls))
