"""XML files read safely: no entities, no document types, bounded size, numbers checked; notes on inertias in them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError, TreeBuilder
from xml.parsers.expat import errors

import numpy as np

from gtau.documents.files import read_at_most
from gtau.errors import GtauError

MAX_BYTES = 1 << 24
MAX_DEPTH = 200
PREFIX = re.compile(rb"(</?|\s)(?!xmlns:)([A-Za-z_][\w.-]*):(?=[\w.-]+(?:[\s/>]|\s*=\s*[\"']))")
"""The prefix of an element or attribute. Simulators' have some that are declared nowhere; no reader looks at these."""


def read_xml(path: Path) -> Element:
    """Read the root element of an XML file.

    Raises
    ------
    GtauError
        The file cannot be read, is larger than 16 MiB, is no XML, declares entities or a document type, or is nested
        more than 200 levels deep. The message does not name the file; the caller does.
    """
    from defusedxml import DefusedXmlException

    larger = "the file is larger than 16 MiB; a robot is text without meshes, so check the path."
    content = read_at_most(MAX_BYTES, path, larger)
    try:
        try:
            root = _parsed(content)
        except ParseError as error:
            if error.code != errors.codes[errors.XML_ERROR_UNBOUND_PREFIX]:
                raise
            root = _parsed(PREFIX.sub(rb"\1\2.", content))
    except DefusedXmlException:
        raise GtauError("the file declares entities or a document type; write their values out.") from None
    except (ParseError, ValueError, LookupError) as error:
        raise GtauError(f"this is not valid XML ({error}); correct the file.") from None
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise GtauError(f"elements are nested more than {MAX_DEPTH} levels deep; check the file.")
    return root


class _Element(Element):
    """An XML element with its line number."""

    line = 0


def _parsed(content: bytes) -> Element:
    from defusedxml.ElementTree import DefusedXMLParser

    class Parser(DefusedXMLParser):  # type: ignore[misc, unused-ignore]
        """Parser that records the line in which an element begins."""

        def _start(self, tag: str, attributes: list[str]) -> Element:
            element: Element = super()._start(tag, attributes)
            element.line = self.parser.CurrentLineNumber  # type: ignore[attr-defined]
            return element

    parser = Parser(target=TreeBuilder(element_factory=_Element), forbid_dtd=True)
    parser.feed(content)
    root: Element = parser.close()
    return root


def line_of(element: Element) -> int:
    """Return the line of the file in which an element begins, 0 if unknown."""
    return int(getattr(element, "line", 0))


DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
ENDLESS = re.compile(r"[+-]?inf(?:inity)?", re.IGNORECASE | re.ASCII)
LARGEST = 1e9  # SI units: no length, angle or mass of a robot comes near; files write 1e16 and more for 'no limit'


def decimals(text: str, endless: bool = False) -> list[float] | None:
    """Read the numbers of an attribute, in plain decimals that a robot can have; None where one is something else.

    With ``endless`` they are limits, which may be infinite or beyond the physical range of a robot.
    """
    values = []
    for word in text.split():
        if not (DECIMAL.fullmatch(word) or (endless and ENDLESS.fullmatch(word))):
            return None
        values.append(float(word))
    return values if endless or all(abs(value) <= LARGEST for value in values) else None


def numbers(text: str, count: int, what: str, endless: bool = False) -> list[float]:
    """Read the numbers of an attribute or element, see :func:`decimals`; refuse any other count."""
    values = decimals(text, endless)
    if values is None or len(values) != count:
        needed = "a plain decimal number" if count == 1 else f"{count} plain decimal numbers"
        size = "" if endless else f", at most {LARGEST:g} in size"
        raise GtauError(f"the {what} is '{text}'; write {needed}{size}.")
    return values


def position_limits(low: float, high: float) -> tuple[float, float] | None:
    """Return position limits, rad or m; None where their range is empty, or one of them is not a limit."""
    return (low, high) if low < high and max(abs(low), abs(high)) <= LARGEST else None


def attribute(element: Element, key: str, what: str) -> str:
    """Read a required attribute."""
    value = element.get(key)
    if not value:
        raise GtauError(f'{what} has no {key}; write {key}="...".')
    return value


TINY = 1e-9  # kg m2: smaller inertias are those of frames that have none
SLACK = 1e-2  # by which the largest principal moment may exceed the sum of the others: files round to a few digits
HEAVIEST = 1000.0  # kg, and times the median mass of the file
SHOWN = 4  # bodies that a note lists


def urdf_masses(root: Element, carried: Mapping[str, str]) -> Iterator[str]:
    """Note implausible masses and inertias of a URDF file.

    Parameters
    ----------
    root : Element
    carried : mapping
        Links by the moving joint whose link they are part of; links of the ground are left out.
    """
    masses, odd, bodies = {}, [], {}
    for link in root.findall("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        given = None if inertial is None else inertial.find("mass")
        masses[name] = 0.0 if given is None else numbers(given.get("value", ""), 1, f"mass of link '{name}'")[0]
        bodies[name] = link
        if inertial is not None and name in carried and (tensor := inertial.find("inertia")) is not None:
            xx, yy, zz, xy, xz, yz = (_number(tensor, f"i{key}") or 0.0 for key in ("xx", "yy", "zz", "xy", "xz", "yz"))
            odd += _impossible(f"link '{name}'", link, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    typical = float(np.median([mass for mass in masses.values() if mass > 1e-6] or [1.0]))
    for name, mass in masses.items():
        if mass < 0.0 or mass > max(HEAVIEST * typical, HEAVIEST):
            odd.append(f"link '{name}' (line {line_of(bodies[name])}) weighs {mass:,.0f} kg")
    yield from _note(odd)
    if any(masses.values()):  # else the file has no masses at all
        moved = {
            joint: [link for link in carried if carried[link] == joint] for joint in dict.fromkeys(carried.values())
        }
        light = [links[0] for links in moved.values() if not any(masses[link] for link in links)]
        if light:
            names = _shown([f"'{name}' (line {line_of(bodies[name])})" for name in light])
            yield (
                f"these links have no mass in the file, though a joint moves them: {names}; here they have parameters "
                "all the same, and where one is really massless, write 'parameters: none' for it in a saved robot file"
            )


def mjcf_masses(roots: Iterable[Element]) -> Iterator[str]:
    """Note implausible explicit masses and inertias of an MJCF file."""
    odd = []
    for body in (each for root in roots for each in root.iter("body")):
        if (inertial := body.find("inertial")) is None:
            continue
        name = f"body '{body.get('name', '')}'"
        mass = _number(inertial, "mass")
        if mass is not None and mass <= 0.0 and body.find("joint") is not None:
            odd.append(f"{name} (line {line_of(inertial)}) weighs {mass:g} kg")
        diagonal, full = (decimals(inertial.get(key, "")) or [] for key in ("diaginertia", "fullinertia"))
        if len(diagonal) == 3:
            odd += _impossible(name, inertial, np.diag(diagonal))
        elif len(full) == 6:
            xx, yy, zz, xy, xz, yz = full
            odd += _impossible(name, inertial, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    yield from _note(odd)


def _impossible(name: str, element: Element, tensor: np.ndarray) -> list[str]:
    """Report impossible moments of an inertia (3, 3), kg m2: negative ones, or one above the sum of the others."""
    moments = np.linalg.eigvalsh(tensor)
    if np.abs(moments).max() < TINY:
        return []
    shown = ", ".join(f"{moment:.3g}" for moment in moments)
    where = f"{name} (line {line_of(element)}) has the principal moments {shown} kg m2"
    if moments[0] < -SLACK * abs(moments[2]):
        return [f"{where}, one of them negative"]
    if moments[2] > (1.0 + SLACK) * (moments[0] + moments[1]):
        return [f"{where}, the largest above the sum of the others"]
    return []


def _note(odd: list[str]) -> Iterator[str]:
    if odd:
        yield (
            f"physically impossible masses and inertias: {_shown(odd, '; ')}; they are identified, not read, but "
            "correct them before you use the file elsewhere"
        )


def _shown(texts: list[str], between: str = ", ") -> str:
    return between.join(texts[:SHOWN]) + (f" and {len(texts) - SHOWN} more" if len(texts) > SHOWN else "")


def _number(element: Element, key: str) -> float | None:
    found = decimals(element.get(key, "")) or []
    return found[0] if len(found) == 1 else None
