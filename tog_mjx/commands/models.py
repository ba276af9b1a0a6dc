"""Can the gradients of these models be trusted? Each MJCF file in a process of its own, and one table of verdicts.

Of a folder every file under it that is an MJCF model of its own. Leaves models.csv and a JSON file with all findings
for each model; the same command continues where it was ended. Exit status 1 if the check of a model crashed.
"""

import csv
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.parsers import expat

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.status import Status
from rich.table import Table

from tog_mjx.checks.alone import COLUMNS, CRASHED, finish_file
from tog_mjx.running.console import CONTINUES, ArgumentParser, run_main, within
from tog_mjx.running.errors import MANY, InputError, printable
from tog_mjx.running.storage import atomic_write, check_writable


def main() -> None:
    args = parse_arguments()
    check_writable(args.out / "models.csv")
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    files = list(dict.fromkeys(mjcf_files(args.models)))
    root = Path(os.path.commonpath([file.parent for file in files]))
    rows = []
    for i, file in enumerate(files, 1):
        name = printable(file.relative_to(root).as_posix())
        with console.status("") as status:
            start = f"[{i}/{len(files)}] {name}: "

            def report(running: str, status: Status = status, start: str = start) -> None:
                status.update(escape(start + running))

            found = finish_file(file, args.out / "models", args.steps, args.quick, args.limit, report)
        console.print(f"{start}{found['verdict']}, {found['seconds']:.0f} s", markup=False)
        rows.append({"model": name, **{column: found[column] for column in COLUMNS}})
    Console(width=None if Console().is_terminal else 160, highlight=False).print(printed(rows))
    write_csv(args.out / "models.csv", rows)
    sys.exit(int(any(row["verdict"] == CRASHED for row in rows)))


def parse_arguments():
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="+", type=Path, metavar="FILE_OR_FOLDER", help="MJCF files, or folders of them")
    parser.add_argument(
        "--steps", type=within(int, 1, MANY), default=100, metavar="N", help="time steps (default: %(default)s)"
    )
    parser.add_argument("--quick", action="store_true", help="leave out float32, stock MJX, and what it costs")
    parser.add_argument("--limit", type=float, default=10.0, metavar="MINUTES", help="a model (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("results/models"), metavar="DIR", help="default: %(default)s")
    args = parser.parse_args()
    if not args.limit > 0:
        parser.error("argument --limit: give a limit above zero")
    return args


def mjcf_files(paths: list[Path]) -> Iterator[Path]:
    """The files named, and all models under the folders."""
    for path in paths:
        if path.is_dir():
            found = sorted(file for file in path.resolve().rglob("*.xml") if is_model(file))
            if not found:
                raise InputError(f"{path}: no MJCF file under this folder")
            yield from found
        elif path.is_file():
            yield path.resolve()
        else:
            raise InputError(f"{path}: no such file or folder")


def is_model(file: Path) -> bool:
    """Whether a file's root is <mujoco> and it has a body's world; a part that others include mostly has none."""
    tags: list[str] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, _: tags.append(tag)
    try:
        parser.Parse(file.read_bytes(), True)
    except (expat.ExpatError, OSError):
        return False
    return tags[:1] == ["mujoco"] and ("worldbody" in tags or "include" in tags)


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, ["model", *COLUMNS], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with atomic_write(path) as file:
        file.write(text.getvalue().encode())


def printed(rows: list[dict[str, Any]]) -> Table:
    table, columns = Table(box=box.MARKDOWN), ("model", "nv", "contacts", "engine", "verdict", "check", "seconds")
    for column in columns:
        table.add_column(column, justify="right" if column in ("nv", "contacts", "seconds") else "left")
    for row in rows:
        table.add_row(*("" if row[column] is None else escape(str(row[column])) for column in columns))
    return table


def run() -> None:
    run_main(main, CONTINUES)
