"""The structure of the package: no import circles, equations of the paper cited, tables made from the code current."""

from __future__ import annotations

import importlib.util
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_no_import_circles_type_only_imports_included() -> None:
    grimp = pytest.importorskip("grimp")
    graph = grimp.build_graph("gtau", exclude_type_checking_imports=False, cache_dir=None)
    assert len(graph.modules) > 150
    TopologicalSorter({m: graph.find_modules_directly_imported_by(m) for m in graph.modules}).prepare()


def script(name: str):
    path = ROOT / "docs" / name
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def equations():
    return script("make_equations.py")


def test_citations_are_read(equations) -> None:
    assert equations.numbers("eq. (15) and eqs. 29 to 33, eqs. (34), (36) and (39); eq. 7") == {
        7, 15, *range(29, 34), 34, 36, 39,
    }  # fmt: skip
    assert equations.numbers("sequence 3, eq 4 and page 5") == set()
    places = set(equations.citations(ROOT / "src" / "gtau" / "model" / "equations.py"))
    assert {(15, "torques"), (14, "torques"), (2, "_wrench"), (1, "")} <= places


def test_every_equation_of_the_paper_is_cited_where_it_is_implemented(equations) -> None:
    found = equations.collect()
    assert found.keys() == set(equations.EQUATIONS) == set(range(1, 40))
    source = ROOT / "src"
    modules = {".".join(path.relative_to(source).with_suffix("").parts) for path in source.rglob("*.py")}
    modules |= {module.removesuffix(".__init__") for module in modules}
    only_modules = [number for number, places in found.items() if modules.intersection(places)]
    assert not only_modules, "cite them in the functions that implement them"


def test_the_table_of_equations_is_current(equations) -> None:
    assert equations.TABLE.read_text(encoding="utf-8") == equations.page(), "run python docs/make_equations.py"


def test_the_table_of_methods_is_current() -> None:
    methods = script("make_methods.py")
    assert methods.PAGE.read_text(encoding="utf-8") == methods.page(), "run python docs/make_methods.py"
    lines = [line.removeprefix("- ").split(": ", 1) for line in methods.table().splitlines()]
    assert [name.strip(" `") for names, _ in lines for name in names.split(",")] == list(methods.PLACES)
    assert all(re.search(r"\. .*choose", what, re.IGNORECASE) for _, what in lines), "say when to choose it"
