"""What MkDocs does for this project beyond its settings in ``mkdocs.yml``.

- Pages from files that lie where a reader of the repository looks for them (`_ELSEWHERE`).
- Links between files of the repository lead to the page or file that was made of them.
- Formulas, ``$...$`` and ``$$...$$``, become MathML: a browser shows it without any script.
- The page of all settings comes from their declaration.
- A page of the API for every package of the core, in the order of the layers in
  ``pyproject.toml``.
"""

from __future__ import annotations

import html
import posixpath
import re
import tomllib
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from pv_inspect.settings import Settings

_ROOT = Path(__file__).resolve().parent.parent

# File of the repository: its place in the site.
_ELSEWHERE = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "sample_data/README.md": "sample-data.md",
    "pv_inspect/cracks/models/MODEL_CARD.md": "model-card.md",
    "LICENSE": "LICENSE.txt",
    "NOTICE": "NOTICE.txt",
    "CITATION.cff": "CITATION.cff",
} | {
    f"examples/{path.name}": f"examples/{path.name}"
    for path in sorted((_ROOT / "examples").glob("*.ipynb"))
}
_LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^()\s#]+)(#[^()\s]*)?(?=\))")
# What the extension arithmatex leaves of a formula.
_BLOCK = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', re.DOTALL)
_INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)


def _packages() -> list[str]:
    """Packages and modules of the core, from the ground up."""
    settings = tomllib.loads((_ROOT / "pyproject.toml").read_text("utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    layers = next(c["layers"] for c in contracts if c["type"] == "layers")
    names = [name.strip() for layer in reversed(layers) for name in layer.split(":")]
    return [name for name in names if not name.startswith("_")]


def _settings_page() -> str:
    """Write all settings with unit, range, default and meaning, grouped by stage."""
    signs = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
    lines = [
        "# Settings",
        "",
        "Names as in Python (`pv.Settings(kappa=-0.1)`) and in a TOML file (`--settings`); "
        "`pv-inspect run --help` lists the options of the command line. A change makes the named "
        "stage run again, and those after it. The last column says where the workbench has it.",
    ]
    stage = None
    for name, about in sorted(
        Settings.model_fields.items(), key=lambda item: Settings.stage_of(item[0]).index
    ):
        if stage != (stage := Settings.stage_of(name)):
            lines += ["", f"## From {stage} on", ""]
            lines += ["| name | unit | range | default | meaning | workbench |"]
            lines += ["|---|---|---|---|---|---|"]
        limits = [
            f"{sign} {getattr(limit, key):g}"
            for limit in about.metadata
            for key, sign in signs.items()
            if hasattr(limit, key)
        ]
        unit = Settings.unit_of(name)
        empty = about.default in (None, ())
        declared = Settings.declared(name)
        place = declared.set_by or f"{declared.group}: {declared.title}"
        lines.append(
            f"| `{name}` | {'' if unit == '1' else unit} | {', '.join(limits)} "
            f"| {'' if empty else f'`{about.default}`'} | {about.description} | {place} |"
        )
    return "\n".join(lines) + "\n"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Append the pages of the API to the navigation."""
    assert config.nav is not None
    stages = [{name: f"api/{name}.md"} for name in _packages()]
    config.nav.append({"API": [{"What is imported as pv": "api/index.md"}, *stages]})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages and files that do not lie in docs/."""
    for source, place in _ELSEWHERE.items():
        files.append(File.generated(config, place, abs_src_path=str(_ROOT / source)))
    files.append(File.generated(config, "settings.md", content=_settings_page()))
    for name in _packages():
        text = (
            f"::: pv_inspect.{name}\n    options:\n      heading_level: 1\n"
            "      show_root_toc_entry: false\n"
        )
        files.append(File.generated(config, f"api/{name}.md", content=text))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Make links between files of the repository links between pages."""
    origins = {place: source for source, place in _ELSEWHERE.items()}
    here = page.file.src_uri
    origin = origins.get(here, f"docs/{here}")

    def moved(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(origin), link[1]))
        place = _ELSEWHERE.get(target) or target.removeprefix("docs/")
        return posixpath.relpath(place, posixpath.dirname(here) or ".") + (link[2] or "")

    return _LINK.sub(moved, markdown)


def on_page_content(content: str, **_: object) -> str:
    """Write formulas as MathML."""
    content = _BLOCK.sub(lambda f: f'<div class="formula">{_mathml(f[1], "block")}</div>', content)
    return _INLINE.sub(lambda f: _mathml(f[1], "inline"), content)


def _mathml(formula: str, display: str) -> str:
    tex = html.unescape(formula)
    written = str(convert(tex, display=display))
    if "\\" in written:  # a command that the converter does not know is left as it is
        raise PluginError(f"This formula can't be written as MathML: {tex}")
    return written
