"""Takes what lies outside docs/ into the site: what its pages link to, and all public names."""

import os
import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import phase_ppl

ROOT = Path(__file__).parents[1]
TAKEN = ["CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md", "examples/README.md"]
TAKEN += sorted(f"examples/{path.name}" for path in ROOT.glob("examples/*.py"))


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add those files as pages, scripts as a page with their code; and the reference."""
    for name in TAKEN:
        text = (ROOT / name).read_text(encoding="utf-8")
        if name.endswith(".py"):
            text = f"# {Path(name).name}\n\n````python\n{text}````\n"
        files.append(File.generated(config, name.replace(".py", ".md"), content=text))
    files.append(File.generated(config, "reference.md", content=reference()))
    return files


def reference() -> str:
    """Return the page of all public names, by the folder or application that they come from."""
    lines = ["# Reference", "Every public name of `phase_ppl`; `ppl.NAME` is how to call it."]
    folder = ""
    for name in sorted({".".join(filter(None, place)) for place in phase_ppl._PLACES.values()}):
        source = name.removeprefix("phase_ppl.").split(".")[0]
        if source != folder:
            folder = source
            lines.append(f"## {folder}")
        lines.append(f"::: {name}")
    return "\n\n".join(lines)


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links between files of the repository lead to their pages in the site."""
    here = posixpath.dirname(page.file.src_uri)
    folder = here if page.file.generated_by else posixpath.join("docs", here)

    def there(link: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join(folder, link[1]))
        path = "docs/index.md" if path == "README.md" else path
        path = path.replace(".py", ".md") if path in TAKEN else path
        return "](" + os.path.relpath(path.removeprefix("docs/"), here or ".")

    return re.sub(r"\]\((?!https?:|#|mailto:)([^)#\s]+)", there, markdown)
