"""Can the gradient be trusted? The gradients of every simulator at random setpoints, against differences of C MuJoCo.

Prints a table for each task, and draws the landscapes of MJX and of the penalty simulator with both gradient fields. A
finished piece is read, not repeated.
"""

from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from tog_mjx.drawing.figures.style import save_figure
from tog_mjx.paper import gradient_agreement as agreement
from tog_mjx.paper.gradient_agreement import METHODS, MJX, PENALTY, REFERENCE, Agreement, Gradients, Piece
from tog_mjx.paper.outcomes import agreement_figure
from tog_mjx.paper.questions import friction_law
from tog_mjx.paper.tasks import TASKS, get_task
from tog_mjx.paper.terms import TERMS
from tog_mjx.running.console import SEEDS, ArgumentParser, run_main, within
from tog_mjx.running.errors import MANY
from tog_mjx.running.progress import Work
from tog_mjx.running.storage import DamagedFileError, check_writable, save_json
from tog_mjx.studies.landscape import gradient_field, landscape

LANDSCAPE, ARROWS = 40, 12
"""Points and arrows of the figure, along each axis."""
WIDTH = 128
"""Characters of the tables."""


def main() -> None:
    args = parse_arguments()
    console = Console(soft_wrap=True, highlight=False)
    methods = [*METHODS, *(TERMS if args.terms else ())]
    tasks = list(TASKS) if args.task == "all" else [args.task]
    pieces = [Piece(task, method, args.points, args.seed) for task in tasks for method in methods]
    check_writable(args.out / "summary.json")
    if not args.force:  # Refused before the work, not in the middle of it.
        for piece in pieces:
            find(piece, args.out, console)

    found = {}
    for i, piece in enumerate(pieces, 1):
        name = f"[{i}/{len(pieces)}] {piece.task}: {piece.method}"
        found[piece] = obtain(piece, name, args.out, args.force, console)
    entries = [agreement.summarise(piece, found[piece], reference_of(piece, found, REFERENCE)) for piece in pieces]
    for task in tasks:
        show(table_of(task, entries), console)
        show(cross_check(task, found), console)
    save_json(args.out / "summary.json", entries)
    if args.optimum:
        show(optima(tasks), console)
    written = [draw(task, found, args.out, console) for task in tasks]
    console.print(
        f"Gradients and summary.json are in {args.out}; figures: {', '.join(map(str, written))}", markup=False
    )


def parse_arguments():
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", choices=[*TASKS, "all"], default="all")
    parser.add_argument(
        "--points",
        type=within(int, 1, MANY),
        default=200,
        metavar="N",
        help="random setpoints a task (default: 200)",
    )
    parser.add_argument(
        "--seed", type=within(int, 0, SEEDS), default=0, metavar="S", help="of the setpoints (default: 0)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("results/gradients"), metavar="DIR", help="default: %(default)s"
    )
    parser.add_argument(
        "--terms", action="store_true", help="also the penalty simulator with one term switched at a time"
    )
    parser.add_argument("--optimum", action="store_true", help="also where descent ends under either friction law")
    parser.add_argument("--force", action="store_true", help="repeat finished pieces and replace their results")
    return parser.parse_args()


def find(piece: Piece, out: Path, console: Console) -> Gradients | None:
    """The result that was kept, if it is there and whole."""
    try:
        return agreement.load(piece, out)
    except FileNotFoundError:
        return None
    except DamagedFileError as error:
        console.print(f"damaged result, computing it again: {error}", style="yellow", markup=False)
        return None


def obtain(piece: Piece, name: str, out: Path, force: bool, console: Console) -> Gradients:
    kept = None if force else find(piece, out, console)
    if kept is not None:
        console.print(f"{name}: finished before, kept", markup=False)
        return kept
    with Work(console).piece(name, piece.points) as report:
        found = agreement.compute(piece, report)
    agreement.save(piece, found, out)
    seconds = f"compiled in {found.seconds_compile:.1f} s, ran {found.seconds_run:.1f} s"
    console.print(f"{name}: {piece.points} gradients; {seconds}", markup=False)
    return found


def reference_of(piece: Piece, found: dict[Piece, Gradients], method: str) -> Gradients:
    return next(result for other, result in found.items() if (other.task, other.method) == (piece.task, method))


COLUMNS = ("finite", "compared", "cosine", "lowest 10 %", "error", "90 %", "worst", "ms", "compile s")


def new_table(title: str, first: str, columns: tuple[str, ...]) -> Table:
    table = Table(title=title, box=box.SIMPLE, title_justify="left")
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def show(table: Table, console: Console) -> None:
    """Whole, however narrow the terminal or the file."""
    Console(width=max(console.width, WIDTH), highlight=False, file=console.file).print(table)


def number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def cells(agreed: Agreement) -> list[str]:
    cosines = [number(agreed.cosine_median, ".7f"), number(agreed.cosine_p10, ".7f")]
    errors = (agreed.relative_error_median, agreed.relative_error_p90, agreed.relative_error_worst)
    return [f"{agreed.finite:.1%}", str(agreed.compared), *cosines, *(number(error, ".1e") for error in errors)]


def table_of(task: str, entries: list[dict]) -> Table:
    chosen = [entry for entry in entries if entry["task"] == task]
    settled = next(entry["settled"] for entry in chosen if entry["method"] == REFERENCE)
    title = f"{task}: gradients against {REFERENCE}, which settle at {settled:.1%} of the setpoints"
    table = new_table(title, "method", COLUMNS)
    for entry in chosen:
        agreed = Agreement(*(entry[name] for name in Agreement._fields))
        table.add_row(
            entry["method"], *cells(agreed), f"{entry['ms_per_gradient']:.1f}", f"{entry['seconds_compile']:.1f}"
        )
    return table


def cross_check(task: str, found: dict[Piece, Gradients]) -> Table:
    """Every method against MJX's own gradient, at all setpoints where that is not zero."""
    table = new_table(f"{task}: gradients against {MJX}", "method", COLUMNS[:-2])
    for piece, result in found.items():
        if piece.task == task and piece.method not in (MJX, REFERENCE):
            table.add_row(piece.method, *cells(agreement.compare(result, reference_of(piece, found, MJX))))
    return table


def optima(tasks: list[str]) -> Table:
    """Where exact descent on the penalty simulator ends under either friction law, and what MJX says of it."""
    columns = ("best setpoints", "J, mujoco friction", "J, paper's friction", "J, mjx")
    table = new_table("Best setpoints of exact descent with Table I's settings, penalty simulator", "descent", columns)
    for task in tasks:
        for law in friction_law.LAWS:
            best, costs = friction_law.optimum(get_task(task), law)
            where = ", ".join(f"{x:.3f}" for x in best)
            table.add_row(f"{task}, {law} friction", where, *(f"{cost:.4f}" for cost in costs))
    return table


def draw(task: str, found: dict[Piece, Gradients], out: Path, console: Console) -> Path:
    """The figure of one task."""
    fields, of = {}, get_task(task)
    for simulator in ("mjx", PENALTY):
        folder = out / task / simulator
        with Work(console).piece(f"{task}: landscape on {simulator}", LANDSCAPE**2, "reading or compiling") as report:
            costs = landscape(of, simulator, of.plane, LANDSCAPE, folder, report)
        with Work(console).piece(f"{task}: gradient field on {simulator}", ARROWS**2, "reading or compiling") as report:
            fields[simulator] = costs, gradient_field(of, simulator, of.plane, ARROWS, folder, report)
    gradients = [next(r for p, r in found.items() if (p.task, p.method) == (task, m)).gradients for m in (MJX, PENALTY)]
    path = out / f"{task}.png"
    save_figure(agreement_figure(get_task(task), fields, agreement.angles(*gradients)), path)
    return path


def run() -> None:
    run_main(main, "what was finished is kept, the same command continues unless it has --force")
