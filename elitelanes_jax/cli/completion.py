"""The command ``elitelanes completion``: scripts with which a shell completes commands, options and their values."""

import argparse
from collections.abc import Callable, Iterator
from typing import NamedTuple

from elitelanes_jax._util.checks import one_of
from elitelanes_jax.cli.arguments import Commands, checked_by
from elitelanes_jax.cli.program import say

_SHELLS = ("bash", "zsh", "fish")

_LOADING = """add one line to the file that the shell reads when it starts:
  ~/.bashrc                   eval "$(elitelanes completion bash)"
  ~/.zshrc                    eval "$(elitelanes completion zsh)", below compinit
  ~/.config/fish/config.fish  elitelanes completion fish | source
"""


class _Command(NamedTuple):
    """A command: its words, its description, its options with theirs, and the commands below it with theirs."""

    words: tuple[str, ...]
    options: dict[str, str]
    below: dict[str, str]


def add_completion(commands: Commands, make_parser: Callable[[], argparse.ArgumentParser]) -> None:
    """Adds the command to a parser's.

    Args:
      commands: of the parser.
      make_parser: makes the parser of all commands.
    """
    command = commands.add_parser(
        "completion",
        help="print a script with which a shell completes commands",
        description="Prints a script with which a shell completes commands, options and their values.",
        epilog=_LOADING,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument("shell", type=checked_by(one_of(*_SHELLS)), metavar="SHELL", help=", ".join(_SHELLS))

    def complete(options: argparse.Namespace) -> int:
        listed = list(_commands(make_parser(), ()))
        script = _fish(listed) if options.shell == "fish" else _bash(listed, zsh=options.shell == "zsh")
        say(script, asked=True)
        return 0

    command.set_defaults(action=complete)


def _commands(parser: argparse.ArgumentParser, words: tuple[str, ...]) -> Iterator[_Command]:
    """Lists a parser's commands, itself first; argparse has no public names for what a parser holds."""
    options = {action.option_strings[-1]: action.help or "" for action in parser._actions if action.option_strings}
    below = next((action for action in parser._actions if isinstance(action, argparse._SubParsersAction)), None)
    helps = {} if below is None else {action.dest: action.help or "" for action in below._choices_actions}
    yield _Command(words, options, helps)
    for name, command in {} if below is None else below.choices.items():
        yield from _commands(command, (*words, name))


def _values() -> dict[str, list[str]]:
    """Returns the words that values of options begin with, by option."""
    from elitelanes_jax.cli.export import FORMATS, TABLES
    from elitelanes_jax.dataset.spec import LAYOUTS
    from elitelanes_jax.network.weights import Weights
    from elitelanes_jax.problem.features import FEATURES, TOWN_FEATURES
    from elitelanes_jax.problem.rules import RULES
    from elitelanes_jax.search.spec import METHODS
    from elitelanes_jax.search.style import STYLES

    return {
        "--style": list(STYLES),
        "--method": list(METHODS),
        "--preset": list(dict.fromkeys(preset for presets in METHODS.values() for preset in presets)),
        "--rules": list(RULES),
        "--format": list(LAYOUTS),
        "--blend": ["on", "off"],
        "--to": [*FORMATS, *TABLES],
        "--where": [f"{name}=" for name in (*FEATURES, *TOWN_FEATURES)],
        "--axes": [f"{name}:" for name in (*FEATURES, *TOWN_FEATURES)],
        "--weights": [f"{name}=" for name in (*Weights._fields, *TOWN_FEATURES)],
        "completion": list(_SHELLS),
        "metrics": [*FEATURES, *TOWN_FEATURES],
    }


def _bash(commands: list[_Command], *, zsh: bool) -> str:
    """Writes the script for bash, or for zsh, which reads it with its own functions for such scripts."""
    cases = [
        f"    '{' '.join(one.words)}') below='{' '.join(one.below)}' options='{' '.join(one.options)}' ;;"
        for one in commands
    ]
    values = [f"    {option}) values='{' '.join(words)}' ;;" for option, words in _values().items()]
    lines = [
        *(["autoload -Uz bashcompinit && bashcompinit"] if zsh else []),
        "_elitelanes() {",
        "  local current=${COMP_WORDS[COMP_CWORD]} command= last= below= options= values= word i",
        "  for ((i = 1; i < COMP_CWORD; i++)); do",
        "    word=${COMP_WORDS[i]}",
        "    if [[ $word == --* ]]; then last=$word",
        "    elif [[ -z $last && ( -z $command || $command == tiles ) ]]; then command=${command:+$command }$word; fi",
        "  done",
        "  case $command in",
        *cases,
        "  esac",
        "  case ${last:-$command} in",
        *values,
        "  esac",
        "  if [[ $current == -* ]]; then",
        '    COMPREPLY=($(compgen -W "$options" -- "$current"))',
        "  elif [[ -n $below && -z $last ]]; then",
        '    COMPREPLY=($(compgen -W "$below" -- "$current"))',
        "  elif [[ -n $values ]]; then",
        '    COMPREPLY=($(compgen -W "$values" -- "$current"))',
        "    [[ $values == *[=:]* ]] && compopt -o nospace 2> /dev/null",
        "  fi",
        "  return 0",
        "}",
        "complete -o default -F _elitelanes elitelanes",
    ]
    return "\n".join(lines)


def _fish(commands: list[_Command]) -> str:
    values = _values()
    lines = ["function __elitelanes_after", "  set -l words (commandline -opc)", "  set -e words[1]"]
    lines += ["  set -l first $words[1..(count $argv)]", '  test "$argv" = "$first"', "end"]
    for one in commands:
        seen = f"__elitelanes_after {' '.join(one.words)}" if one.words else "true"
        here = f"not __fish_seen_subcommand_from {' '.join(one.below)}; and {seen}"
        for name, words in one.below.items():
            lines.append(f"complete -c elitelanes -f -n {_quoted(here)} -a {name} -d {_quoted(words)}")
        for option, words in one.options.items() if one.words else ():
            given = f"-x -a {_quoted(' '.join(values[option]))} " if option in values else ""
            lines.append(f"complete -c elitelanes -n {_quoted(seen)} -l {option[2:]} {given}-d {_quoted(words)}")
        if one.words and one.words[0] in values:
            lines.append(f"complete -c elitelanes -f -n {_quoted(seen)} -a {_quoted(' '.join(values[one.words[0]]))}")
    return "\n".join(lines)


def _quoted(text: str) -> str:
    return "'" + text.replace("%%", "%").replace("\\", "\\\\").replace("'", "\\'") + "'"
