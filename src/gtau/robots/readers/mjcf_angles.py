"""Angles of an MJCF file in the wrong unit: it counts in degrees unless its compiler says radians."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import pi
from typing import TYPE_CHECKING

from gtau.errors import GtauError
from gtau.robots.geometry import SHORT
from gtau.robots.readers.xml_document import line_of
from gtau.robots.units import in_degrees

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

SHOWN = 4


def angle_notes(roots: list[Element]) -> Iterator[str]:
    """Note orientations and limits that are multiples of pi/4 in a file that counts in degrees.

    Raises
    ------
    GtauError
        An orientation is degrees in a file that counts in radians.
    """
    units = [compiler.get("angle") for root in roots for compiler in root.iter("compiler") if compiler.get("angle")]
    if "radian" in units:
        for element, what, angle in _angles(roots, ("body", "frame")):
            if in_degrees(angle):
                raise GtauError(
                    f"line {line_of(element)}: {what} holds {angle:g}, but the file counts in radians (angle of "
                    "<compiler>); divide it by 57.2958 where it is in degrees."
                )
        return
    meant = [
        f"{what} (line {line_of(element)}: {angle:g})"
        for element, what, angle in _angles(roots, ("body", "frame", "joint"))
        if _in_radians(angle)
    ]
    if meant:
        more = f" and {len(meant) - SHOWN} more" if len(meant) > SHOWN else ""
        yield (
            f"angles that look like radians, though the file counts in degrees (angle of <compiler>): "
            f"{', '.join(meant[:SHOWN])}{more}; they were taken as degrees"
        )


def _in_radians(angle: float) -> bool:
    """Decide whether an angle given as degrees is a multiple of pi/4 up to a turn instead."""
    eighths = round(angle / (pi / 4))
    return 0 < abs(eighths) <= 8 and abs(angle - eighths * pi / 4) < SHORT


def _angles(roots: Iterable[Element], tags: tuple[str, ...]) -> Iterator[tuple[Element, str, float]]:
    """Iterate over the angles of orientations and of hinge limits, with their element and what they are."""
    for element in (each for root in roots for tag in tags for each in root.iter(tag)):
        name = f"{element.tag} '{element.get('name', element.get('class', ''))}'"
        key = "range" if element.tag == "joint" else "euler"
        if element.tag == "joint" and element.get("type", "hinge") != "hinge":
            continue
        if element.tag == "frame" and element.find(".//body") is None:
            continue  # of shapes
        for angle in _numbers(element.get(key, "")):
            yield element, f"{key} of {name}", angle
        if element.tag != "joint" and len(turn := _numbers(element.get("axisangle", ""))) == 4:
            yield element, f"axisangle of {name}", turn[3]


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []
