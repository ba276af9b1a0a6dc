"""`tog COMMAND ...` and `python -m tog_mjx COMMAND ...`: the modules of `tog_mjx.commands`, by name.

Only the module of the command that was asked for is imported, and none to list them.
"""

import ast
import importlib
import shutil
import signal
import sys
import textwrap
from pathlib import Path

import tog_mjx
from tog_mjx.running.errors import near, printable

COMMANDS = Path(__file__).parent / "commands"


def main() -> None:
    """Runs the command that `sys.argv` names; without one, lists all."""
    program = "python -m tog_mjx" if Path(sys.argv[0]).name == "__main__.py" else "tog"
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in ("-h", "--help"):
        print(usage(program))
        return
    if name not in (names := list(commands())):
        print(f"{program}: no command {printable(name)}{near(name, names)} (see --help)", file=sys.stderr)
        sys.exit(2)
    sys.argv = [f"{program} {name}", *arguments]
    run(name)


def run(name: str) -> None:
    """Runs a command with what `sys.argv` holds; its first part is the name by which the command speaks of itself."""
    # Ctrl-C while libraries load, which takes a second or two, leaves no traceback.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        command = importlib.import_module(f"tog_mjx.commands.{name}")
    except ModuleNotFoundError as error:
        if str(error.name).startswith("tog_mjx"):
            raise
        remedy = f"pip install {error.name}; tog doctor says what else is missing"
        print(f"{Path(sys.argv[0]).name}: the package {error.name} is not installed: {remedy}", file=sys.stderr)
        sys.exit(2)
    command.run()


def commands() -> dict[str, str]:
    """The first line of each command's docstring, by the command's name."""
    files = sorted(COMMANDS.glob("[a-z]*.py"))
    return {file.stem: (ast.get_docstring(ast.parse(file.read_text())) or "").splitlines()[0] for file in files}


def usage(program: str) -> str:
    fill = textwrap.TextWrapper(shutil.get_terminal_size((120, 24)).columns, subsequent_indent=" " * 13).fill
    listed = (fill(f"  {name:<11}{line}") for name, line in commands().items())
    head = f"usage: {program} COMMAND ...\n\n{tog_mjx.__doc__}\n"
    return "\n".join([head, *listed, f"\n{program} COMMAND --help tells of one."])


if __name__ == "__main__":
    main()
