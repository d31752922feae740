"""Moves finished files to their place, safely even if the program is killed, and without touching files of the user.

A run with results in `x` works in the folder `.x.partial` beside it. There is a lock, which the system releases when
the process dies, and a folder into which the files are written. When all files are there, this folder is renamed to
`done` or `failed`. From then on the result is complete, and its files are moved one by one to `x` or `x.failed`. If the
program is killed during this, the next program that looks at `x` goes on with it (`repair`). The list of the files is
moved last; only files on the list of an earlier run are ever replaced or removed. All functions are for rank 0.
"""

import contextlib
import fcntl
import json
import os
import shutil
import time
from pathlib import Path, PurePosixPath

from signorini_fenicsx.base.errors import InputError

MANIFEST = "files.json"
"""Lists the files in a results folder that the program wrote."""
MARK = "summary.json"
"""Identifies a results folder of an old version that wrote no list."""

OWN = (
    *("checkpoint/about.json", "facets/00000.parquet"),
    *(MARK, "checkpoint.npz", "history.csv", "facets.csv", "solution.xdmf", "solution.h5"),
    *(f"{name}.bp/{part}" for name in ("solution", "multiplier") for part in ("data.0", "md.0", "md.idx", "mmd.0")),
    *(f"{name}.bp/profiling.json" for name in ("solution", "multiplier")),
    *("u.png", "sigma.png", "signorini.png", "iterations.png", "certificate.png"),
    *("convergence.csv", "convergence.png", "adapt.csv", "adapt.png", "mesh.png"),
)
"""Names of files that the program writes; in a folder without a list, files with these names are the program's."""

PARTIAL, LOCK, DONE, FAILED = ".partial", "lock", "done", "failed"


def failed_place(target: Path) -> Path:
    """The folder in which the state of a failed run is kept."""
    return target.with_name(target.name + ".failed")


def area_of(target: Path) -> Path:
    """The folder in which runs with this target work."""
    return target.with_name(f".{target.name}{PARTIAL}")


def locked(area: Path, patience: float) -> int | None:
    """Make an area, if there is none, and lock it. Returns the lock, or None if another process keeps it.

    Raises:
        OSError: If this is not possible, for example because the file system has no locks.
    """
    until = time.monotonic() + patience
    while True:
        with contextlib.suppress(FileExistsError):
            area.mkdir()
        try:
            lock = os.open(area / LOCK, os.O_CREAT | os.O_RDWR, 0o666)
        except FileNotFoundError:  # the process before has just removed the area
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(lock), os.stat(area / LOCK)):
                return lock
        except FileNotFoundError:  # likewise
            pass
        except BlockingIOError:
            if time.monotonic() > until:
                os.close(lock)
                return None
            time.sleep(0.01)
        except OSError:
            os.close(lock)
            raise
        os.close(lock)


def release(area: Path, lock: int) -> None:
    """Remove everything in an area that is not complete, and release its lock."""
    tidy(area)
    if [entry.name for entry in area.iterdir()] == [LOCK]:
        (area / LOCK).unlink()
        with contextlib.suppress(OSError):  # another process is in it already
            area.rmdir()
    os.close(lock)


def tidy(area: Path) -> None:
    """Remove what killed runs have left in an area, except complete results."""
    for entry in area.iterdir():
        if entry.name not in (LOCK, DONE, FAILED):
            delete(entry)


def delete(path: Path) -> None:
    """Remove a file, or a folder with all that is in it."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def commit(staging: Path, end: str, *, add: bool = False) -> None:
    """Make the files of a staging folder the results (`DONE`) or the failure (`FAILED`) of its target.

    Args:
        staging: A folder in the area of the target, which is locked.
        end: `DONE` or `FAILED`.
        add: Keep earlier results with other names.
    """
    area = staging.parent
    files = [path for path in staging.rglob("*") if path.is_file()]
    names = {path.relative_to(staging).as_posix() for path in files}
    _write_manifest(staging, names | (listed(_target(area)) if add else set()))
    for path in (*files, staging / MANIFEST):
        _flush(path)  # some file systems report only now that the disk is full
    staging.rename(area / end)
    settle(area)


def settle(area: Path) -> None:
    """Move complete results to their place."""
    target = _target(area)
    for end, place in ((DONE, target), (FAILED, failed_place(target))):
        ready = area / end
        if (ready / MANIFEST).is_file():
            if end == DONE:
                clear(failed_place(target))  # it is out of date
            if place.exists():
                _exchange(ready, place)
            else:
                ready.rename(place)
        if ready.exists():
            shutil.rmtree(ready)


def _exchange(ready: Path, place: Path) -> None:
    """Replace the files of the run before. If this was interrupted, a second call goes on from there."""
    new, old = listed(ready), listed(place)
    for name in sorted(new):
        if (ready / name).exists():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (ready / name).replace(place / name)
    _remove(place, old - new)
    (ready / MANIFEST).replace(place / MANIFEST)


def repair(folder: Path | str) -> None:
    """Complete the results or the failure that a killed run has left for this folder."""
    place = Path(os.path.realpath(folder))
    if place == place.parent:
        return  # the root folder has nothing beside it
    for target in {place, place.with_name(place.name.removesuffix(".failed") or place.name)}:
        area = area_of(target)
        with contextlib.suppress(OSError):  # a folder of another user, which may only be read
            if area.is_dir() and (lock := locked(area, patience=1.0 if _is_complete(area) else 0.0)) is not None:
                try:
                    settle(area)
                finally:
                    release(area, lock)


def clear(place: Path) -> None:
    """Remove a results folder, but keep files of the user in it.

    Raises:
        InputError: If its list is damaged.
    """
    names = listed(place)
    if not names and not (place / MANIFEST).exists():
        return
    _remove(place, names)
    if any(entry.name != MANIFEST for entry in place.iterdir()):
        _write_manifest(place, set())  # so it is still recognised as a results folder
    else:
        (place / MANIFEST).unlink(missing_ok=True)
        place.rmdir()


def listed(place: Path) -> set[str]:
    """The files in a folder that the program wrote, as paths in it with slashes.

    Raises:
        InputError: If their list is damaged.
    """
    path = place / MANIFEST
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        names = found.get("files") if isinstance(found, dict) and found.get("written_by") == __package__ else None
        if not isinstance(names, list) or not all(isinstance(name, str) and _is_below(name) for name in names):
            raise ValueError
    except (FileNotFoundError, NotADirectoryError):
        return {name for name in OWN if (place / name).is_file()} if (place / MARK).is_file() else set()
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is not the list that an earlier run wrote there; move it elsewhere") from None
    return set(names)


def check(place: Path) -> None:
    """Refuse a place for results that is used for something else, or where something is in the way (rank 0).

    Raises:
        InputError: If it is.
    """
    if place.is_symlink():
        raise InputError(f"output {place}: is a link; name the folder that it leads to")
    if not place.exists():
        return
    if not place.is_dir():
        raise InputError(f"output {place}: is a file, not a folder")
    ours = listed(place)
    if any(place.iterdir()) and not ours and not (place / MANIFEST).is_file():
        raise InputError(f"output {place}: is not empty and holds no {MARK}; choose another folder")
    for name in {*OWN, *ours, MANIFEST}:
        path = place / name
        for folder in path.relative_to(place).parents[:-1]:
            if os.path.lexists(place / folder) and ((place / folder).is_symlink() or not (place / folder).is_dir()):
                raise InputError(f"output {place / folder}: is in the way, as it is not a folder; move it elsewhere")
        if os.path.lexists(path) and (not path.is_file() or path.is_symlink() or name not in {*ours, MANIFEST}):
            raise InputError(f"output {path}: is in the way, as no earlier run wrote it; move it elsewhere")


def _target(area: Path) -> Path:
    return area.with_name(area.name[1 : -len(PARTIAL)])


def _is_complete(area: Path) -> bool:
    return any((area / end / MANIFEST).exists() for end in (DONE, FAILED))


def _is_below(name: str) -> bool:
    path = PurePosixPath(name)
    return path.parts != () and not path.is_absolute() and ".." not in path.parts and "\0" not in name


def _write_manifest(folder: Path, names: set[str]) -> None:
    part = folder / f"{MANIFEST}.part"
    part.write_text(json.dumps({"written_by": __package__, "files": sorted(names)}, indent=2) + "\n", encoding="utf-8")
    part.replace(folder / MANIFEST)


def _remove(place: Path, names: set[str]) -> None:
    """Remove these files of a folder, and subfolders that are then empty."""
    for name in names:
        (place / name).unlink(missing_ok=True)
    for folder in {folder for name in names for folder in PurePosixPath(name).parents[:-1]}:
        with contextlib.suppress(OSError):  # it holds files of the user
            (place / folder).rmdir()


def _flush(path: Path) -> None:
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
