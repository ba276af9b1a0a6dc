"""The tutorial runs from end to end, in its short setting, and finds what its text says."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

NOTEBOOK = Path(__file__).parent.parent / "scripts" / "tutorial.ipynb"
FOUND = """
import json
print(json.dumps({
    "verdicts": [verdict.word, trusted.word],
    "gains": [float(gain_exact), float(gains.mean())],
    "solved": [float(found.costs[0]), float(found.costs.min())],
    "policy": [float(before), float(after)],
    "slopes": [float(slope @ outward) for slope in slopes.values()],
    "best": {name: [float(cost) for cost in costs] for name, costs in best.items()},
}))
"""


def cells(kind: str) -> list[dict]:
    return [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == kind]


def test_it_is_kept_without_outputs():
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells("code"))


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict:
    nbformat = pytest.importorskip("nbformat", reason="pip install '.[tutorial]'")
    nbclient = pytest.importorskip("nbclient", reason="pip install '.[tutorial]'")
    pytest.importorskip("ipykernel", reason="pip install '.[tutorial]'")
    folder = tmp_path_factory.mktemp("tutorial")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell(FOUND))
    environment = {**os.environ, "TOG_MJX_SHORT": "1", "MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    with pytest.MonkeyPatch.context() as patch:
        # The kernel is of this very Python, whichever ones are installed for the user.
        patch.setenv("JUPYTER_DATA_DIR", str(tmp_path_factory.mktemp("jupyter")))
        client = nbclient.NotebookClient(
            notebook, kernel_name="python3", timeout=None, resources={"metadata": {"path": str(folder)}}
        )
        client.execute(env=environment)
    assert {path.name for path in folder.iterdir()} == {"push.gif", "policy.gif"}
    return json.loads(notebook.cells[-1].outputs[0].text)


def test_the_verdict_on_the_default_contact_is_with_care_and_on_the_soft_one_trust(found):
    assert found["verdicts"] == ["trust with care", "trust"]


def test_the_exact_gradient_gains_more_than_estimates(found):
    exact, estimates = found["gains"]
    assert exact > estimates > 0


def test_the_push_is_solved_and_the_policy_is_no_worse_than_its_guess(found):
    first, best = found["solved"]
    assert best < 0.3 * first
    before, after = found["policy"]
    assert after <= before


def test_at_the_lifting_point_autodiff_says_lift_and_the_landscape_does_not(found):
    """Those of the page on touch-downs, along x of the window, in which both fingers move by as much."""
    np.testing.assert_allclose(found["slopes"], np.array([-0.224, 0.016]) / np.sqrt(2), rtol=0.05)


def test_autodiff_grasps_and_the_gradient_with_the_jumps_does_not(found):
    assert max(found["best"]["autodiff"]) <= 0.2 < min(found["best"]["with the jumps"])
