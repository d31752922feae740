"""Meshes that do not fit into memory are refused before they are made."""

import os
from pathlib import Path

import pytest
from commands import signorini

from signorini_fenicsx.base.parallel import give_back_memory
from signorini_fenicsx.meshes import memory
from signorini_fenicsx.meshes.memory import available


def put(system: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (system / name).parent.mkdir(parents=True, exist_ok=True)
        (system / name).write_text(text)
    return system


def test_the_least_limit_counts(tmp_path: Path):
    """Free memory, the limit of the process's group, of the group above it, and the first version of groups."""
    assert available(tmp_path) == float("inf")
    system = put(tmp_path, {"proc/meminfo": "MemTotal: 9000 kB\nMemAvailable:  8000 kB\n"})
    assert available(system) == 8000 * 1024
    put(system, {"proc/self/cgroup": "3:cpu:/x\n0::/a/b\n", "sys/fs/cgroup/a/b/memory.max": "max\n"})
    put(system, {"sys/fs/cgroup/a/memory.max": "5000000", "sys/fs/cgroup/a/memory.current": "4000000\n"})
    assert available(system) == 1000000
    put(system, {"sys/fs/cgroup/a/memory.stat": "anon 3\ninactive_file 500000\n"})
    assert available(system) == 1500000
    put(system, {"proc/self/cgroup": "4:cpu,memory:/c\n"})
    old = {"memory.limit_in_bytes": "70000", "memory.usage_in_bytes": "60000", "memory.stat": "total_inactive_file 5\n"}
    put(system, {f"sys/fs/cgroup/memory/c/{name}": text for name, text in old.items()})
    assert available(system) == 10005
    put(system, {"sys/fs/cgroup/memory/c/memory.usage_in_bytes": "90000"})
    assert available(system) == 0


def test_free_memory_is_given_back():
    """Small objects below one that stays, which the C library keeps otherwise."""

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    size, number = 3000, 30_000
    blocks = [bytes(size) for _ in range(number)]
    del blocks[:-1]
    before = resident()
    give_back_memory()
    assert resident() < before - size * number / 2


@pytest.mark.parallel([1, 2])
def test_what_does_not_fit_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """With h of a shape, h of a file and the mesh of a file; ranks of one machine share its memory."""
    monkeypatch.setattr(memory, "available", lambda: 2e5)
    for arguments, advice in (
        (("example1", "--h", "1/128"), "h = 0.19 fits"),
        (("cube", "--h", "1/16"), "h = 0.7 fits"),
        (("electropainting",), "take a coarser mesh or more machines"),
    ):
        done = signorini(folder, "solve", *arguments)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
        assert done.stderr.endswith(f"; {advice}\n")
    assert list(folder.iterdir()) == []
