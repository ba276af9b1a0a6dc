"""Studies beyond the paper: which gradient, which update rule, from where, with statistics.

Every finished cell is kept, so that a killed study continues with --resume. Leaves, in a folder named after each study,
table.csv (one row a run, or a point of one), summary.csv (one row a group, with 95 % Wilson intervals of success where
its runs are a random sample) and, of a study that has one, its figure.
"""

import io
from pathlib import Path

import pandas as pd
from rich import box
from rich.console import Console
from rich.table import Table

from tog_mjx.drawing.figures.style import save_figure
from tog_mjx.paper.questions.catalogue import STUDIES
from tog_mjx.running.console import ArgumentParser, run_main
from tog_mjx.running.progress import Work
from tog_mjx.running.storage import atomic_write, check_writable
from tog_mjx.studies.study import Drawn, Store


def main() -> None:
    args = parse_arguments()
    console = Console(width=None if Console().is_terminal else 320, highlight=False)
    check_writable(args.out / "table.csv")
    store = Store(args.out / "cells", args.resume)
    for name in args.names:
        study, folder = STUDIES[name], args.out / (f"{name}_quick" if args.quick else name)
        table = study.run(args.quick, store, Work(console).piece)
        found = study.summary(table)
        console.print(printed(f"{name}: {study.question}", found))
        write_csv(folder / "table.csv", table)
        write_csv(folder / "summary.csv", found)
        if isinstance(study, Drawn):
            save_figure(study.draw(args.quick, store, table), folder / f"{name}.png")


def parse_arguments():
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="+", choices=list(STUDIES), metavar="NAME", help=", ".join(STUDIES))
    parser.add_argument("--quick", action="store_true", help="a small version, for a first look")
    parser.add_argument("--out", type=Path, default=Path("results/studies"), metavar="DIR", help="default: %(default)s")
    parser.add_argument("--resume", action="store_true", help="do not compute again what the folder holds")
    return parser.parse_args()


def write_csv(path: Path, table: pd.DataFrame) -> None:
    text = io.StringIO()
    table.to_csv(text, index=False)
    with atomic_write(path) as file:
        file.write(text.getvalue().encode())


def printed(title: str, found: pd.DataFrame) -> Table:
    table = Table(title=title, title_justify="left", box=box.MARKDOWN)
    for column in found.columns:
        table.add_column(column, justify="left" if found[column].dtype.kind in "OTU" else "right", no_wrap=True)
    for row in found.itertuples(index=False):
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row))
    return table


def run() -> None:
    run_main(main, "what was finished is kept, with --resume the same command continues")
