"""The package's metadata: the recipe asks for what the wheel asks for, and versions agree."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CONDA = {"matplotlib": "matplotlib-base"}


def test_the_recipe_has_the_dependencies_of_the_wheel() -> None:
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    asked = {re.split(r"[>=<]", each)[0]: each for each in PROJECT["dependencies"]}
    listed = {each.split()[0]: each for each in recipe["requirements"]["run"]}
    assert listed.pop("python") == f"python {PROJECT['requires-python']}"
    assert {CONDA.get(name, name) for name in asked} == set(listed)
    for name, each in asked.items():
        assert listed[CONDA.get(name, name)].split()[1] == each.removeprefix(name)


def test_versions_agree() -> None:
    recipe = (ROOT / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == PROJECT["version"]
    assert f'version: "{PROJECT["version"]}"' in recipe


def test_the_systems_of_the_classifiers_have_a_job() -> None:
    jobs = (ROOT / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8")
    for system, runner in (("MacOS", "macos"), ("Windows", "windows"), ("Linux", "ubuntu")):
        assert any(system in each for each in PROJECT["classifiers"])
        assert f"{runner}-latest" in jobs
