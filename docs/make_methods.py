"""Write the lists of effects and of methods in ``lookup/verdicts.md``.

What an effect is, is the first sentence of the docstring of its module. What an estimator is, and when to choose it,
are the first sentence of the docstring of its module, and those that say when to choose it.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

from gtau.estimation.effects.known import EFFECTS
from gtau.estimation.estimators import PLACES

PAGE = Path(__file__).parent / "lookup" / "verdicts.md"
OF_EFFECTS = "<!-- made by python docs/make_methods.py from the docstrings of the effects -->"
BEGIN = "<!-- made by python docs/make_methods.py from the docstrings of the estimators -->"


def sentences(docstring: str) -> tuple[str, str]:
    """Return the first sentence of a module's docstring, and those that say when to choose it."""
    found = re.split(r"(?<=\.)\s+(?=[A-Z`])", " ".join(docstring.replace("``", "`").split()))
    return found[0], " ".join(each for each in found[1:] if re.search(r"\bchoose\b", each, re.IGNORECASE))


def table() -> str:
    """Return the list of methods; estimators of one module share a line."""
    modules: dict[str, list[str]] = {}
    for name, place in PLACES.items():
        modules.setdefault(place.split(".")[0], []).append(f"`{name}`")
    lines = []
    for module, names in modules.items():
        what, when = sentences(import_module(f"gtau.estimation.estimators.{module}").__doc__ or "")
        lines.append(f"- {', '.join(names)}: {what} {when}")
    return "\n".join(lines)


def effects() -> str:
    """Return the list of the effects, in bold where they contradict the description."""
    named: dict[tuple[str, str], list[str]] = {}  # by what they are: effects of one module share a line
    for effect in EFFECTS:
        what, _ = sentences(import_module(effect.say.__module__).__doc__ or "")
        beyond = "" if effect.harmless == float("inf") or effect.description else f" (beyond {effect.harmless:g})"
        bold = "**" if effect.description or beyond else ""
        named.setdefault((what, beyond), []).append(f"{bold}{effect.name}{bold}")
    return "\n".join(f"- {', '.join(names)}{beyond}: {what}" for (what, beyond), names in named.items())


def page() -> str:
    """Return the page with the present tables in place of those that it has."""
    text = PAGE.read_text(encoding="utf-8")
    for begin, made in ((OF_EFFECTS, effects()), (BEGIN, table())):
        before, rest = text.split(f"{begin}\n", 1)
        _, after = rest.split("\n\n", 1)
        text = f"{before}{begin}\n{made}\n\n{after}"
    return text


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
