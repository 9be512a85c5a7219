"""The type checker that tests put into the package; as for static checkers, an int is a float too."""

from beartype import BeartypeConf, beartype

__all__ = ["typecheck"]

typecheck = beartype(conf=BeartypeConf(is_pep484_tower=True))
