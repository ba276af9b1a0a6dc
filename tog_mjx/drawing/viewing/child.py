"""Python in a process of its own, for what may end or hang the process that tries it."""

import subprocess
import sys
from collections.abc import Mapping


def run_python(*arguments: str, environment: Mapping[str, str] | None = None) -> str | None:
    """Runs Python with these arguments. Returns None if it ended well, else the last line of its complaint."""
    program = [sys.executable, *arguments]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines()
    return lines[-1] if lines and done.returncode > 0 else f"ended by signal {-done.returncode}"
