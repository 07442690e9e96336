"""Parameters of every body in the orders of Pinocchio, MuJoCo, Drake, MATLAB's rigidBodyTree and SYMORO, as CSV."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from gtau.documents.files import in_csv
from gtau.estimation.results.result import Result
from gtau.export.consistent import consistent_model
from gtau.export.exported import Exported, written
from gtau.export.names import identifier
from gtau.export.parameter_orders import ORDERS, to_order

DRIVES = {"ia": "IA", "fv": "FV", "fs": "FS"}


def export(result: Result, out: Path) -> Exported:
    """Write ``NAME_PROGRAM.csv`` into ``out`` for each program: one row per body, one column per parameter, SI units.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters.
    """
    model = consistent_model(result, "parameter orders")
    texts, notes = {}, []
    for program, order in ORDERS.items():
        table = []
        for body in result.robot.bodies:
            row: dict[str, object] = {"body": body, **to_order(model.standard, body, program)}
            if program == "symoro":
                row |= {name: model.of(kind, body) for kind, name in DRIVES.items()}
            table.append(row)
        texts[f"{identifier(result.robot.name)}_{program}.csv"] = in_csv(pl.DataFrame(table))
        notes.append(f"{program}: {order.explained}")
    notes.append("all in the frames of gtau's links: a joint's frame, after its motion")
    return Exported(written(out, texts), tuple(notes))
