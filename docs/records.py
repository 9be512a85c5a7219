"""Lets the reference show records as they are made: all their fields, and the plain default of each."""

from typing import Any

from griffe import Class, Expr, ExprCall, Extension, Function, Parameter, ParameterKind, Parameters

__all__ = ["Records"]


class Records(Extension):
    """Gives each NamedTuple the `__init__` that Python makes for it, and each dataclass plain defaults.

    A record of options that has its own constructor is shown with one argument for each field. griffe itself makes the
    `__init__` of dataclasses, once a package is read.
    """

    def on_class_members(self, *, cls: Class, **_: Any) -> None:
        """Changes a class whose members are read."""
        for field in cls.attributes.values():
            field.value = _plain_default(field.value)
        if "NamedTuple" in map(str, cls.bases):
            _add_init(cls)
        elif "Record" in map(str, cls.bases) and "__init__" in cls.functions:
            _list_options(cls)


def _plain_default(value: str | Expr | None) -> str | Expr | None:
    """Returns the default that a call of `option`, `nested`, `static` or `traced` declares, or the value as it is."""
    if not isinstance(value, ExprCall):
        return value
    declaration, first = str(value.function), next(iter(value.arguments), None)
    if declaration not in ("option", "nested", "static", "traced"):
        return value
    return None if str(first) == "REQUIRED" else first


def _add_init(cls: Class) -> None:
    own = _parameters(cls, ParameterKind.positional_or_keyword)
    cls.set_member("__init__", Function("__init__", parameters=own, returns="None", parent=cls))


def _list_options(cls: Class) -> None:
    """Replaces ``**given`` in a constructor by the fields that it stands for."""
    cls.functions["__init__"].parameters = _parameters(cls, ParameterKind.keyword_only)


def _parameters(cls: Class, kind: ParameterKind) -> Parameters:
    fields = (
        Parameter(field.name, annotation=field.annotation, kind=kind, default=field.value)
        for field in cls.attributes.values()
        if field.annotation and "property" not in field.labels and not field.name.startswith("_")
    )
    return Parameters(Parameter("self", kind=ParameterKind.positional_or_keyword), *fields)
