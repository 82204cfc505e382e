"""Runs the pages that are notebooks, and shows what came out under each cell.

A page whose front matter names a ``jupyter`` kernel is a notebook in Jupytext's Markdown: blocks of
``python`` are its cells, and JupyterLab opens it as it stands. A cell that fails ends the build.
"""

import os
import posixpath
import tempfile
from pathlib import Path

import jupytext
import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

LONGEST = 900
"""Seconds that a cell may take, or a kernel to start."""

_compiled = tempfile.TemporaryDirectory()


def on_startup(**_: object) -> None:
    """Let the notebooks of a build share what XLA compiles for them."""
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", _compiled.name)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the page with the outputs of its cells, and add these and the notebook as files."""
    if "jupyter" not in page.meta:
        return markdown
    notebook = jupytext.reads(markdown, fmt="md")
    with tempfile.TemporaryDirectory() as folder:
        where = {"metadata": {"path": folder}}
        limits = {"timeout": LONGEST, "startup_timeout": LONGEST}
        NotebookClient(notebook, kernel_name="python3", resources=where, **limits).execute()
    for cell in notebook.cells:
        if cell.cell_type == "code":  # without progress bars
            cell.outputs = [one for one in cell.outputs if one.get("name") != "stderr"]
    name = Path(page.file.src_uri).stem
    key = {"unique_key": name, "output_files_dir": posixpath.join("outputs", name)}
    text, found = MarkdownExporter().from_notebook_node(notebook, resources=key)
    copies = {**found["outputs"], f"{name}.ipynb": nbformat.writes(notebook)}
    for uri, content in copies.items():
        files.append(File.generated(config, uri, content=content))
    title, rest = text.strip().split("\n", 1)
    return f"{title}\n\n*All that is shown here was run: [the notebook]({name}.ipynb).*\n{rest}"
