"""Drive gains as an INI file."""

from pathlib import Path

from gtau import GtauError, Result
from gtau.export.exported import Export, Exported, written


def export(result: Result, out: Path) -> Exported:
    """Write ``gains.ini`` into ``out``."""
    lines = ["[gains]"]
    for joint, gain in result.drive_gains.items():
        if gain.value is None:
            raise GtauError(f"the drive gain of joint '{joint}' is not identifiable; log a known payload.")
        lines.append(f"{joint} = {gain.value!r} ; {gain.unit}")
    notes = ("an INI file has no place for standard deviations",)
    return Exported(written(out, {"gains.ini": "\n".join([*lines, ""])}), notes)


GAINS_INI = Export(export)
