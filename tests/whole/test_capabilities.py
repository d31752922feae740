"""What the program can do gives the results that were recorded, also on two or three ranks, see `capabilities`."""

import json
from pathlib import Path
from typing import Any

import pytest
from capabilities import GOLDEN, Capability, capabilities, differences, on_ranks, run

ON_RANKS = {each.name for some in on_ranks() for each in some}
"""Names of the capabilities that are run on several ranks; on one rank they are slow tests."""


@pytest.fixture(scope="module")
def recorded() -> dict[str, Any]:
    """The recorded results of all capabilities, by their names."""
    return json.loads(GOLDEN.read_text(encoding="utf-8"))


def test_each_capability_has_a_name_and_a_record(recorded: dict[str, Any]) -> None:
    names = [capability.name for capability in capabilities()]
    assert sorted(names) == sorted(recorded)


@pytest.mark.parametrize(
    "capability",
    [
        pytest.param(each, id=each.name, marks=pytest.mark.slow if each.slow or each.name in ON_RANKS else ())
        for each in capabilities()
    ],
)
def test_results_are_those_recorded(capability: Capability, recorded: dict[str, Any], tmp_path: Path) -> None:
    assert capability.differences(recorded[capability.name], run(capability, tmp_path)) == []


@pytest.mark.parallel(3)
@pytest.mark.parametrize("capability", [pytest.param(each, id=each.name) for each in on_ranks()[0]])
def test_ranks_do_not_matter(capability: Capability, recorded: dict[str, Any], folder: Path) -> None:
    """On three ranks the numbers in all files are those recorded on one."""
    assert capability.differences(recorded[capability.name], run(capability, folder)) == []


@pytest.mark.parallel(2)
@pytest.mark.parametrize("capability", [pytest.param(each, id=each.name) for each in on_ranks()[1]])
def test_two_ranks_do_not_matter(capability: Capability, recorded: dict[str, Any], folder: Path) -> None:
    """On two ranks, as many as there are cores, the numbers in all files are those recorded on one."""
    assert capability.differences(recorded[capability.name], run(capability, folder)) == []


def test_differences_are_found() -> None:
    one = {"status": [0], "numbers": {"summary.json/norms/u": [1.0], "summary.json/norms/p": [1e-3], "u.npy": [1, 2]}}
    other = {"status": [0], "numbers": {**one["numbers"], "summary.json/norms/p": [1.001e-3]}}
    assert differences(one, one) == []
    assert differences(one, other) == [(pytest.approx(1e-6), "summary.json/norms/p")]
    assert differences(one, {**one, "status": [1]})[0][0] == float("inf")
    assert differences(one, {"status": [0], "numbers": {}})[0][0] == float("inf")
    assert differences(one, other, {"p"}) == []
    meshes = [{"status": [0], "numbers": {"summary.json/cells": [n], "summary.json/h": [1 / n]}} for n in (8.0, 9.0)]
    assert Capability("solve crack", ()).differences(*meshes) == []
    assert Capability("solve crack", ()).differences(meshes[0], {"status": [0], "numbers": {}}) != []
    assert len(Capability("solve plate", ()).differences(*meshes)) == 2
