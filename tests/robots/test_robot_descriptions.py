"""Robots of the package robot_descriptions, by a package of the same form: read where on disk, never fetched."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from gtau.errors import GtauError
from gtau.model.home import load_robot

URDF = """<robot name="one"><link name="base"/><link name="arm"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""
HEAD = '''"""One."""

from os import getenv as _getenv
from os import path as _path

from ._cache import clone_to_cache as _clone_to_cache

REPOSITORY_PATH: str = _clone_to_cache(
    "one-data",
    commit=_getenv("ROBOT_DESCRIPTION_COMMIT", None),
)

PACKAGE_PATH: str = _path.join(REPOSITORY_PATH, "robots", "one")
'''
PATH = 'URDF_PATH: str = _path.join(\n    PACKAGE_PATH, "one.urdf"\n)\n'
REPOSITORIES = """raise RuntimeError("imported")

REPOSITORIES = {"one-data": Repository(url="nowhere", commit="1", cache_path="one_data")}
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of repositories of an installed package, whose modules must not be imported."""
    package = tmp_path / "installed" / "robot_descriptions"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text('raise RuntimeError("imported")\n')
    (package / "_repositories.py").write_text(REPOSITORIES)
    (package / "one_description.py").write_text(HEAD + PATH)
    (package / "made_description.py").write_text(HEAD + 'XACRO_PATH: str = _path.join(PACKAGE_PATH, "one.xacro")\n')
    (package / "broken_description.py").write_text("URDF_PATH: str = (\n")
    monkeypatch.syspath_prepend(str(package.parent))
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "cache"))
    monkeypatch.delitem(sys.modules, "robot_descriptions", raising=False)
    return tmp_path / "cache"


def test_a_file_on_disk_is_read_by_the_name_of_its_module(cache: Path) -> None:
    for name in ("one_description", "one"):
        with pytest.raises(GtauError, match=r"not its file on disk .*one.urdf.*robot_descriptions pull one_desc"):
            load_robot(name)
    file = cache / "one_data" / "robots" / "one" / "one.urdf"
    file.parent.mkdir(parents=True)
    file.write_text(URDF)
    for name in ("one_description", "one"):
        assert load_robot(name).actuated == ("turn",)
    assert "robot_descriptions" not in sys.modules
    assert load_robot("five-bar").name == "five-bar"  # the catalog comes first


def test_what_it_does_not_have_is_refused(cache: Path) -> None:
    for name, sentence in (
        ("made", "names no URDF or MJCF file of 'made_description'; where xacro makes it, give the path"),
        ("broken", "names no URDF or MJCF file of 'broken_description'"),
        ("two", "no robot is called 'two'"),
        ("_repositories", "no robot is called '_repositories'"),
    ):
        with pytest.raises(GtauError, match=sentence):
            load_robot(name)
