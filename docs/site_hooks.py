"""What the site adds to Sphinx: menus from the lists of the shelves, formulas as MathML, and ``llms.txt``."""

from __future__ import annotations

import re
from importlib import import_module
from inspect import getdoc, isfunction, unwrap
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from matplotlib.figure import Figure
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, NumpyDocstring
from sphinx_gallery.scrapers import figure_rst

NUMPY_STYLE = Config(
    napoleon_use_param=False, napoleon_use_rtype=False, napoleon_custom_sections=[("Attributes", "params_style")]
)
ATTRIBUTES = "Attributes\n----------\n"
LAST_SENTENCE = re.compile(r"(Attributes\n-{10}\n.*)\n\n(\S[^\n]*\.)$", re.DOTALL)
LINK = re.compile(r"\]\(([\w./-]+?)(?:\.md|\.html)(?:#[\w-]*)?\)")
ITEM = re.compile(r"^- \[(?P<title>[^]]+)\]\((?P<page>[^)]+)\.\w+\): (?P<text>.+)\n", re.MULTILINE)
CARD = ":::{{grid-item-card}} {title}\n:link: {page}\n:link-type: doc\n\n{text}\n:::\n\n"
START = re.compile(r"^\[(Get started)\]\((.+)\.md\)$", re.MULTILINE)
BUTTON = r":::{button-ref} \2\n:ref-type: doc\n:color: primary\n\n\1\n:::"
ELSEWHERE = {r"README\.md": "index.md", r"examples/gallery/README\.rst": "gallery/index.rst"}
SHELVES = ("start/index", "do/index", "lookup/index", "evidence/index", "gallery/index")


def add_menu(app: Sphinx, name: str, content: list[str]) -> None:
    """Add to an index the menu of the pages of its folder, in the order of its links; on the first page, cards.

    A directive in the file would show as a block of code where the file is read without Sphinx.
    """
    for outside, page in ELSEWHERE.items():
        content[0] = re.sub(rf"\((?:\.\./)+{outside}(?:#[\w-]*)?\)", f"(/{page})", content[0])
    if name == "index":
        pages = list(SHELVES)
        cards = "".join(CARD.format(**each.groupdict()) for each in ITEM.finditer(content[0]))
        content[0] = (
            START.sub(BUTTON, ITEM.sub("", content[0])) + f"\n::::{{grid}} 1 2 3 3\n:gutter: 3\n\n{cards}::::\n"
        )
    elif name.endswith("/index") and name != "gallery/index":
        here = Path(app.srcdir, name).parent
        listed = [page for page in LINK.findall(content[0]) if (here / f"{page}.md").is_file()]
        pages = list(dict.fromkeys(page for page in listed if not page.startswith("..")))
    else:
        return
    content[0] += "\n```{toctree}\n:hidden:\n\n" + "\n".join(pages) + "\n```\n"


def set_type(app: Sphinx, document: nodes.document) -> None:
    """Keep a number and its per cent on one line, and write dashes as such."""
    for text in list(document.findall(nodes.Text)):
        if not isinstance(text.parent, (nodes.literal, nodes.literal_block)):
            text.parent.replace(text, nodes.Text(text.replace(" %", "\N{NO-BREAK SPACE}%").replace(" -- ", " – ")))


def read_docstring(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Read a docstring in NumPy style; the types in it, which have shapes and units, are words and no references.

    Napoleon itself takes what stands before a colon in the docstring of a property for a type.
    """
    if what == "class" and "Attributes" not in lines:  # those that it inherits
        inherited = (getdoc(each) or "" for each in obj.__mro__[1:] if each.__module__.startswith("gtau."))
        lines += next(
            (f"{ATTRIBUTES}{text.split(ATTRIBUTES)[1]}" for text in inherited if ATTRIBUTES in text), ""
        ).split("\n")
    what = "method" if what == "property" else what
    found = NumpyDocstring(lines, NUMPY_STYLE, app, what, name, obj, options).lines()
    lines[:] = [re.sub(r"docs/(\S+)\.md", r":doc:`/\1`", line.replace(" -- ", " – ")) for line in found]


def show_defaults(app: Sphinx, what: str, name: str, obj: Any, options: Any, text: str, returns: str) -> Any:
    """Show the number or text that a constant stands for as a default, and no internal function or record."""
    text = re.sub(r"=(lambda [^,]*|<factory>|[A-Z]\w*\((?:[^()]|\([^()]*\))*\))(?=[,)])", "=...", text or "")
    function = unwrap(obj) if text else None
    if not isfunction(function):
        return (text, returns) if text else None
    names, values = function.__code__.co_varnames[: function.__code__.co_argcount], function.__defaults__ or ()
    defaults = dict(zip(names[len(names) - len(values) :], values, strict=True)) | (function.__kwdefaults__ or {})
    for parameter, value in defaults.items():  # autodoc replaces those of the signature by their words in the source
        if isinstance(value, (int, float, str)):
            text = re.sub(rf"\b{parameter}=[A-Z_.]*[A-Z]{{2}}[A-Z_]*\b", f"{parameter}={value!r}", text)
        else:
            words = getattr(value, "__name__", "[A-Z_]{2,}")
            text = re.sub(rf"\b{parameter}={words}(?=[,)])", f"{parameter}=...", text)
    return text, returns


def keep_names_without_page(app: Sphinx, env: Any, node: Any, content: Any) -> Any:
    """Leave a docstring's reference to a name without a page as text, if there is such a name."""
    target = node.get("reftarget", "")
    if node.get("refdomain") != "py" or "." not in target:
        return None
    module, names = target, []
    while module:
        try:
            found = import_module(module)
        except ModuleNotFoundError:
            module, _, last = module.rpartition(".")
            names.insert(0, last)
            continue
        for each in names:
            found = getattr(found, each, None) or found.__annotations__[each]
        return content
    return None


def inline_formula(translator: Any, node: nodes.math) -> None:
    """Write a formula within a line as MathML, which browsers show by themselves."""
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def displayed_formula(translator: Any, node: nodes.math_block) -> None:
    """Write a formula on lines of its own as MathML."""
    translator.body.append(f"<p>{convert(node.astext(), display='block')}</p>")
    raise nodes.SkipNode


def draw_figures(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Draw the figures of ``result.plot`` that a block of a script of the gallery makes; pyplot does not list them."""
    paths = []
    for figure in block_vars["example_globals"].values():
        if isinstance(figure, Figure) and figure.get_gid() is None:
            figure.set_gid("drawn")
            if figure.canvas.manager is None:
                paths.append(next(block_vars["image_path_iterator"]))
                figure.savefig(paths[-1], dpi=100)
    return figure_rst(paths, gallery_conf["src_dir"])


def write_llms(app: Sphinx, exception: Exception | None) -> None:
    """Write ``llms.txt``: the title of every page and its Markdown, shelf by shelf, for language models."""
    if exception or app.builder.name != "html":
        return
    titles = app.env.titles
    lines = ["# gtau", "", "> Drive gains and dynamic parameters of robots, from logged positions and currents."]
    for shelf in SHELVES:
        folder = shelf.partition("/")[0]
        lines += ["", f"## {titles[shelf].astext()}", ""]
        for page in sorted(each for each in titles if each.startswith(f"{folder}/")):
            written = Path(app.env.doc2path(page)).suffix == ".md"
            lines.append(f"- [{titles[page].astext()}]({f'_sources/{page}.md' if written else f'{page}.html'})")
    Path(app.outdir, "llms.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the additions."""
    app.connect("source-read", add_menu)
    app.connect("doctree-read", set_type)
    app.connect("autodoc-process-docstring", read_docstring)
    app.connect("autodoc-process-signature", show_defaults)
    app.connect("missing-reference", keep_names_without_page)
    app.connect("build-finished", write_llms)
    app.add_html_math_renderer("mathml", (inline_formula, None), (displayed_formula, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
