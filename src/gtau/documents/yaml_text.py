"""YAML as gtau writes it, as a person would: read back by :mod:`gtau.documents.yaml_document`."""

from __future__ import annotations

import re
from typing import Any

import yaml


class _Dumper(yaml.SafeDumper):
    """Safe, and with joints called ``11`` as they are written by hand, without quotes."""


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    kind = "int" if re.fullmatch("0|[1-9][0-9]*", text) else "str"
    return dumper.represent_scalar(f"tag:yaml.org,2002:{kind}", text)


_Dumper.add_representer(str, _text)


def yaml_text(data: Any, flow: bool | None = None, width: float = 120) -> str:
    """Write mappings, lists, texts and numbers as YAML, keys in their order.

    Parameters
    ----------
    data : object
        Nested dicts and lists.
    flow : bool, optional
        Whether all of it stands in braces and brackets; if left out, only the innermost groups do.
    width : float
        Characters after which a line is broken.
    """
    text: str = yaml.dump(
        data, Dumper=_Dumper, default_flow_style=flow, sort_keys=False, width=width, allow_unicode=True
    )
    return text
