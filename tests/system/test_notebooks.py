"""The notebooks: committed with their results, and every assertion in them holds when
they run at reduced size."""

import re
from pathlib import Path

import nbformat
import pytest
from suites import needed

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
LONGEST = 300  # seconds for one cell, compilation of all kernels included; a warm notebook takes less than 25 in all
MACHINE = re.compile(
    r"/(?:home|root|tmp|usr|opt|var|work|mnt|Users|private)/|[A-Z]:\\\\|site-packages|\.py:\d"
)


def read(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    return notebook


def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def failures(notebook):
    """What a committed notebook should not be."""
    found = [
        f"{cell.id}: not executed"
        for cell in code(notebook)
        if cell.execution_count is None
    ]
    outputs = [(cell.id, output) for cell in code(notebook) for output in cell.outputs]
    found += [
        f"{name}: {output.ename}"
        for name, output in outputs
        if output.output_type == "error"
    ]
    found += [
        f"{name}: {output.text}"
        for name, output in outputs
        if output.get("name") == "stderr"
    ]
    found += [
        f"{name}: a path of a machine"
        for name, output in outputs
        if MACHINE.search(text_of(output))
    ]
    if not any("image/png" in output.get("data", {}) for _, output in outputs):
        found.append("no picture")
    if [cell.execution_count for cell in code(notebook)] != list(
        range(1, len(code(notebook)) + 1)
    ):
        found.append("not executed from top to bottom in a fresh kernel")
    return found


def text_of(output):
    """All of an output but its pictures."""
    data = {
        kind: part
        for kind, part in output.get("data", {}).items()
        if kind != "image/png"
    }
    return str({**output, "data": data})


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_committed_with_results(path):
    notebook = read(path)
    assert failures(notebook) == []
    # times of execution change for nothing
    assert not any("execution" in cell.metadata for cell in notebook.cells)
    assert notebook.metadata.kernelspec.name == "python3"
    assert path.stat().st_size < 800_000  # some ten pictures of 150 dpi


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs_at_reduced_size(path, tmp_path, monkeypatch):
    """Seeds are fixed; each notebook states the false-alarm rate of a fresh one."""
    monkeypatch.setenv("EQSIM_QUICK", "1")
    monkeypatch.delenv("MPLBACKEND", raising=False)
    notebook = read(path)
    for cell in code(notebook):
        cell.outputs, cell.execution_count = [], None
    needed("ipykernel")
    client = needed("nbclient").NotebookClient(
        notebook,
        timeout=LONGEST,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    )
    client.execute()
    assert failures(notebook) == []
    assert list(tmp_path.iterdir()) == []  # a notebook shows, it leaves nothing behind


@pytest.mark.long
def test_a_failed_assertion_is_noticed(tmp_path):
    """What a notebook asserts is what is tested: the same machinery fails on a false
    statement."""
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell("assert 1 + 1 == 3")]
    )
    nbclient = needed("nbclient")
    needed("ipykernel")
    with pytest.raises(nbclient.exceptions.CellExecutionError):
        nbclient.NotebookClient(
            notebook, timeout=60, resources={"metadata": {"path": str(tmp_path)}}
        ).execute()
    assert any("AssertionError" in failure for failure in failures(notebook))
