"""Sphinx: the site of README, docs, notebooks and docstrings. `make docs` builds it; no request leaves a page.

Formulas become MathML here, so pages need no script for them. Pages of the API, the effects and the command line are
written anew from the code before each build (`reference_pages.py`).
"""

import re
import sys
from collections.abc import Callable
from pathlib import Path

from docutils.nodes import Element, SkipNode
from latex2mathml.converter import convert
from pygments.lexers import TextLexer
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.writers.html5 import HTML5Translator

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.insert(0, str(DOCS))

project, author, copyright = "invdyn", "The invdyn authors", "The invdyn authors, Apache-2.0"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["pictures.py", "reference_pages.py", "numbers_page.py"]
html_theme = "furo"
html_title = "invdyn"
highlight_language = "text"  # blocks without a language are commands
html_static_path = ["static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
templates_path: list[str] = []

myst_enable_extensions = ["dollarmath", "colon_fence", "html_image"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # `make notebooks` has executed them
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_use_ivar = True
napoleon_use_rtype = False
suppress_warnings = ["ref.python"]  # a short name that several classes have, as `q`: the nearest is linked


_COLUMNS = re.compile(r"\S {3,}\S")
_ROLE, _NAME = re.compile(r":\w+:`~?\.*([^`]*)`"), r"\1"  # markup that a literal block would show
_BARS = re.compile(r"(?<!`)\|(?![^`]*``)")  # not within ``code``


class SourceFiles(SphinxPostTransform):
    """Links to source files of the repository, where README and CONTRIBUTING are read, too: here the name alone."""

    default_priority = 8  # before MyST says that there is no such page

    def run(self, **kwargs: object) -> None:
        """Replace each such link by its text."""
        places = (Path(self.env.doc2path(self.env.docname)).parent, ROOT, ROOT / "benchmarks")
        for node in list(self.document.findall(pending_xref)):
            files = [folder / f"{node['reftarget']}{suffix}" for folder in places for suffix in ("", ".md")]
            page = node["reftarget"] in self.env.all_docs
            if node["reftype"] == "myst" and not page and any(file.is_file() for file in files):
                node.replace_self(node[0].deepcopy())


def _mathml(display: str) -> Callable[[HTML5Translator, Element], None]:
    """A visitor that writes a formula as MathML and is done with its node."""

    def visit(writer: HTML5Translator, node: Element) -> None:
        writer.body.append(convert(node.astext(), display=display))
        raise SkipNode

    return visit


def _as_written(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Show a docstring as it is written: a module's tables and formulas keep their columns, and |x| is no markup."""
    shown: list[str] = []
    for paragraph in "\n".join(lines).split("\n\n"):
        rows = paragraph.split("\n")
        if what == "module" and (_COLUMNS.search(paragraph) or rows[0].startswith("    ")):
            shown += ["::", "", *(f"    {_ROLE.sub(_NAME, row)}" for row in rows), ""]
        else:
            shown += [*(_BARS.sub(r"\\|", row) for row in rows), ""]
    lines[:] = shown


def _write_pages(app: Sphinx) -> None:
    from reference_pages import write_pages

    write_pages(DOCS / "reference", app.config.effect_pictures)


def setup(app: Sphinx) -> None:
    """Register the formulas' renderer and the pages that are written from the code."""
    app.add_html_math_renderer("mathml", (_mathml("inline"), None), (_mathml("block"), None))
    app.add_lexer("csv", TextLexer)
    app.add_post_transform(SourceFiles)
    app.add_config_value("effect_pictures", True, "env")  # -D effect_pictures=0: quickly, without them
    app.connect("builder-inited", _write_pages, priority=100)
    app.connect("autodoc-process-docstring", _as_written, priority=100)  # before napoleon
