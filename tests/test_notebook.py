"""The notebooks of the examples: they run, and their committed outputs are what comes out.

After a change of one, write its outputs anew: python tests/test_notebook.py examples/drive.ipynb
"""

import base64
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"
NOTEBOOKS = sorted(path.name for path in EXAMPLES.glob("*.ipynb"))

every_notebook = pytest.mark.parametrize("name", NOTEBOOKS)

NEEDED = ("ipykernel", "matplotlib", "nbclient", "nbformat")
MISSING = [name for name in NEEDED if find_spec(name) is None]

# What would differ on each machine, and change the file with every run.
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}

# Paths of a machine, and addresses of objects.
PRIVATE = re.compile(r"/(?:tmp|home|root|Users|private|var)/|[A-Z]:\\|\bat 0x[0-9a-f]+")

Cell = dict[str, Any]


def execute(source: Path, target: Path) -> None:
    """Run a notebook in a clean kernel of this interpreter, and write it with its outputs.

    CellExecutionError, with the cell and its traceback, where a cell raises.
    """
    import matplotlib.font_manager  # noqa: F401, PLC0415 - to make its cache here, not in a cell
    import nbformat  # noqa: PLC0415
    from jupyter_client.kernelspec import KernelSpecManager  # noqa: PLC0415
    from jupyter_client.manager import AsyncKernelManager  # noqa: PLC0415
    from nbclient import NotebookClient  # noqa: PLC0415

    notebook = nbformat.read(source, as_version=4)  # type: ignore[no-untyped-call]
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        # Nothing of the user's own: no kernels, no startup files, no style of pictures.
        for database in EXAMPLES.glob("*.dbc"):
            shutil.copy(database, folder)
        os.environ |= {"IPYTHONDIR": folder, "JUPYTER_RUNTIME_DIR": folder}
        kernels = KernelSpecManager(kernel_dirs=[])
        manager = AsyncKernelManager(kernel_name="python3", kernel_spec_manager=kernels)
        client = NotebookClient(
            notebook,
            km=manager,
            timeout=120,
            coalesce_streams=True,
            record_timing=False,
            resources={"metadata": {"path": folder}},
        )
        client.execute(cleanup_kc=True)
    notebook.metadata.clear()
    notebook.metadata.update(METADATA)
    nbformat.write(notebook, target)  # type: ignore[no-untyped-call]


def code_cells(notebook: Path) -> list[Cell]:
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def text_outputs(cell: Cell) -> list[tuple[str, str]]:
    """Return all that a cell put out but pictures, in order: the kind and the text."""
    return [
        (str(output.get("name", output["output_type"])), "".join(text))
        for output in cell["outputs"]
        for text in [output.get("text"), output.get("data", {}).get("text/plain")]
        if text is not None
    ]


def pictures(cell: Cell) -> list[bytes]:
    data = [output.get("data", {}) for output in cell["outputs"]]
    return [base64.b64decode("".join(each["image/png"])) for each in data if "image/png" in each]


@pytest.mark.long
@pytest.mark.skipif(
    os.environ.get("CANSER_LONG") != "1", reason="takes long: CANSER_LONG=1, as in .ci/run"
)
@every_notebook
@pytest.mark.skipif(
    bool(MISSING), reason=f"not installed: {', '.join(MISSING)}; pip install 'canser[notebook]'"
)
def test_runs_and_puts_out_what_is_committed(name: str, tmp_path: Path) -> None:
    fresh = tmp_path / "fresh.ipynb"
    # A process of its own: an event loop, sockets and their warnings stay out of this one.
    done = subprocess.run(
        [sys.executable, __file__, str(EXAMPLES / name), str(fresh)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout
    for committed, cell in zip(code_cells(EXAMPLES / name), code_cells(fresh), strict=True):
        assert text_outputs(cell) == text_outputs(committed), "stale: see this file's first lines"
        assert len(pictures(cell)) == len(pictures(committed))


@every_notebook
def test_committed_is_executed_in_order(name: str) -> None:
    cells = code_cells(EXAMPLES / name)
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell["outputs"]]
    shown = [output for output in outputs if "image/png" in output.get("data", {})]
    # No error, and nothing put out by accident.
    assert {output["output_type"] for output in shown} <= {"display_data", "execute_result"}
    assert {output["output_type"] for output in outputs if output not in shown} == {"stream"}
    assert "stderr" not in {name for cell in cells for name, _ in text_outputs(cell)}


@every_notebook
def test_committed_has_pictures(name: str) -> None:
    found = [picture for cell in code_cells(EXAMPLES / name) for picture in pictures(cell)]
    assert found
    assert all(picture.startswith(b"\x89PNG\r\n\x1a\n") for picture in found)
    assert (EXAMPLES / name).stat().st_size < 400_000


@every_notebook
def test_committed_has_nothing_of_a_machine(name: str) -> None:
    notebook = json.loads((EXAMPLES / name).read_text("utf-8"))
    assert notebook["metadata"] == METADATA
    for cell in notebook["cells"]:
        assert cell["metadata"] == {}
        assert not PRIVATE.search("".join(cell["source"]))
        for _, text in text_outputs(cell) if cell["cell_type"] == "code" else []:
            assert not PRIVATE.search(text)


if __name__ == "__main__":
    execute(Path(sys.argv[1]), Path(sys.argv[-1]))
