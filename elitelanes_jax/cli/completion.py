"""The command ``elitelanes completion``: scripts with which a shell completes commands, options and their values."""

import argparse
from collections.abc import Callable, Iterator

from elitelanes_jax._util.checks import one_of
from elitelanes_jax.cli.arguments import Commands, add_command, checked_by
from elitelanes_jax.cli.program import say

_SHELLS = ("bash", "zsh", "fish", "tcsh", "powershell")

# No space follows a name that a value follows. Words without a completion are files.
_BASH = """
_elitelanes() {
  _shtab_elitelanes
  [[ ${COMPREPLY-} == *[=:] ]] && compopt -o nospace 2> /dev/null
  return 0
}
complete -o default -F _elitelanes elitelanes"""


def add_completion(commands: Commands, make_parser: Callable[[], argparse.ArgumentParser]) -> None:
    def complete(options: argparse.Namespace) -> int:
        import shtab

        parser, words = make_parser(), _words()
        for name, action in _actions(parser):
            if name in words:
                action.choices = words[name]
            elif action.nargs != 0:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
        say(shtab.complete(parser, options.shell) + _BASH * (options.shell == "bash"), asked=True)
        return 0

    command = add_command(
        commands,
        "completion",
        complete,
        help="print a script with which a shell completes commands",
        description="Prints a script with which a shell completes commands, options and their values.",
        notes="""add one line to the file that the shell reads when it starts:
  ~/.bashrc                   eval "$(elitelanes completion bash)"
  ~/.zshrc                    eval "$(elitelanes completion zsh)", below compinit
  ~/.config/fish/config.fish  elitelanes completion fish | source
""",
    )
    command.add_argument("shell", type=checked_by(one_of(*_SHELLS)), metavar="SHELL", help=", ".join(_SHELLS))


def _actions(parser: argparse.ArgumentParser, command: str = "") -> Iterator[tuple[str, argparse.Action]]:
    """Yields all arguments, each with the name of the option or, for positional arguments, of the command."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, below in action.choices.items():
                yield from _actions(below, name)
        else:
            yield action.option_strings[-1] if action.option_strings else command, action


def _words() -> dict[str, list[str]]:
    """Returns the words with which values of arguments begin, by the name of the option or command."""
    from elitelanes_jax.cli.export import TABLES
    from elitelanes_jax.dataset.spec import LAYOUTS
    from elitelanes_jax.maps.exporting import FORMATS
    from elitelanes_jax.network.records import Weights
    from elitelanes_jax.problem.features import FEATURES, TOWN_FEATURES
    from elitelanes_jax.problem.inventory import COUNTED
    from elitelanes_jax.problem.rules import RULES
    from elitelanes_jax.search.spec import METHODS
    from elitelanes_jax.search.style import STYLES

    features = (*FEATURES, *TOWN_FEATURES)
    return {
        "--style": list(STYLES),
        "--method": list(METHODS),
        "--preset": list(dict.fromkeys(preset for presets in METHODS.values() for preset in presets)),
        "--rules": list(RULES),
        "--format": list(LAYOUTS),
        "--to": [*FORMATS, *TABLES],
        "--where": [f"{name}=" for name in features],
        "--axes": [f"{name}:" for name in features],
        "--inventory": [f"{kind}=" for kind in COUNTED],
        "--weights": [f"{name}=" for name in (*Weights._fields, *TOWN_FEATURES)],
        "completion": list(_SHELLS),
        "metrics": [*features],
    }
