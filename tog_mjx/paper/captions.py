"""What each figure shows, in words: under it in the report, and in place of it for those who cannot see it."""

from tog_mjx.paper.tasks import Task

DIFFERS = {
    "released": "This is the paper's own program, restated.",
    "penalty": (
        "Other than the paper's program, penalty damps fingers critically, moves box corners as a rigid body does, "
        "steps semi-implicitly and takes MuJoCo's friction law; a finger is a sphere of 2 cm."
    ),
    "mjx": (
        "Other than the paper's program, mjx damps fingers critically and has MuJoCo's soft contact and friction "
        "cone; a finger is a sphere of 2 cm."
    ),
}
"""What sets a simulator apart from the program that drew the paper's figures."""


def setups() -> str:
    return "The two tasks: start of box and fingers, goal of the box, and the initial guess of the setpoints."


def landscape(task: Task, simulator: str) -> str:
    u = task.initial_guess
    mirrored = "" if len(u) == 2 else " of the left finger, the right one mirrored"
    path = "" if len(u) == 2 else " The stochastic path does not stay mirrored; that of its left finger is drawn."
    return (
        f"Cost of the box {task.name} over the setpoint{mirrored}; the initial guess ({u[0]:g}, {u[1]:g}) m; and, "
        f"beyond the paper, the paths of both descents.{path} {DIFFERS[simulator]}"
    )


def descents(task: Task, simulator: str) -> str:
    return (
        f"Cost of the box {task.name} against iteration, for both methods; stars mark the best iterates, dotted lines "
        f"the published runs. {DIFFERS[simulator]}"
    )


def motions(task: Task, simulator: str) -> str:
    return (
        f"Motion of the box {task.name} under the initial guess and under the best setpoints of each method, later "
        f"boxes darker, with the paths of the fingers and their setpoints. {DIFFERS[simulator]}"
    )
