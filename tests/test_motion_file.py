"""Test that a saved and loaded motion is the same bit for bit, and that damaged and hostile files are refused."""

from __future__ import annotations

import dataclasses
import io
import json
import re
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import refusal

from recon import InputError, Motion
from recon.base.files import write_manifest
from recon.base.records import RECORD, _Layout, load_record, save_record
from recon.fit.motion_forms import CLASSES, MOTION, SCHEMA

FILES = Path(__file__).parent / "files"


def differences(a: Any, b: Any, where: str = "") -> list[str]:
    """Return the paths of fields in which two trees of dataclasses differ, even in the last bit."""
    if type(a) is not type(b) and not (isinstance(a, tuple | list) and isinstance(b, tuple | list)):
        return [f"{where}: {type(a)} {type(b)}"]
    if isinstance(a, np.ndarray):
        return [] if a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes() else [where]
    if dataclasses.is_dataclass(a):
        names = [field.name for field in dataclasses.fields(a) if field.init]
        return [found for name in names for found in differences(getattr(a, name), getattr(b, name), f"{where}.{name}")]
    if isinstance(a, dict):
        missing = [] if [*a] == [*b] else [f"{where}: {[*a]} {[*b]}"]
        return missing or [found for key in a for found in differences(a[key], b[key], f"{where}.{key}")]
    if isinstance(a, tuple | list):
        if len(a) != len(b):
            return [f"{where}: {len(a)} {len(b)}"]
        return [found for i, pair in enumerate(zip(a, b, strict=True)) for found in differences(*pair, f"{where}.{i}")]
    same = a == b or (isinstance(a, float) and np.isnan(a) and np.isnan(b))
    return [] if same else [f"{where}: {a!r} {b!r}"]


@pytest.mark.parametrize("fixture", ["small_motion", "small_trajectory", "world_trajectory"])
def test_loaded_motion_is_the_same(fixture: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    motion = request.getfixturevalue(fixture)
    motion = replace(motion, settings={"fps": 30, "frames": None, "keypoints": ["a.csv"]}, timing_s={"solve_s": 0.1})
    motion.save(tmp_path / "new")
    loaded = Motion.load(tmp_path / "new")
    assert type(loaded.solution) is type(motion.solution)
    assert not differences(motion, loaded)


def test_saving_again_gives_the_same_file(small_trajectory: Motion, tmp_path: Path) -> None:
    first, second = (small_trajectory.save(tmp_path / name).read_bytes() for name in ("a", "b"))
    third = Motion.load(tmp_path / "a").save(tmp_path / "c").read_bytes()
    assert first == second == third


@pytest.fixture
def saved(small_trajectory: Motion, tmp_path: Path) -> Path:
    return small_trajectory.save(tmp_path)


def refuses(path: Path, *expected: tuple[object, ...]) -> None:
    """Check that a motion file is refused for the expected problems, given as in `refusal`, but without the file."""
    with refusal(*((path, *one) for one in expected)):
        Motion.load(path.parent)


def rewritten(path: Path, change: Callable[[dict[str, np.ndarray], dict[str, Any]], None]) -> None:
    """Rewrite a motion file after `change` has changed its arrays and its record."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    record = json.loads(arrays.pop("record").tobytes())
    change(arrays, record)
    np.savez(path, record=np.frombuffer(json.dumps(record).encode(), np.uint8), **arrays)


def as_version_3(arrays: dict[str, np.ndarray], record: dict[str, Any]) -> None:
    """Change arrays and record to schema version 3, with every array unpacked under the name of its first field."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            if "stored" not in value:
                return {key: plain(item) for key, item in value.items()}
            name = value.pop("array")
            if arrays[name].dtype == np.uint8:
                arrays[name] = _Layout(**(value | {"shape": tuple(value["shape"])})).unpacked(arrays[name])
            return {"array": name}
        return [plain(item) for item in value] if isinstance(value, list) else value

    record.update(value=plain(record["value"]), schema=record["schema"] | {"version": 3})


def cut_states(arrays: dict[str, np.ndarray], record: dict[str, Any]) -> None:
    """Drop the state of the first frame, so that shapes disagree."""
    as_version_3(arrays, record)
    arrays["solution.states"] = arrays["solution.states"][1:]


def test_damaged_bytes(saved: Path) -> None:
    whole = saved.read_bytes()
    for content in (b"PK\x03\x04", whole[:-30], whole[: len(whole) // 2], b"x" * 100):
        saved.write_bytes(content)
        refuses(saved, ("content", "cannot be read"))
    saved.write_bytes(b"")
    refuses(saved, ("file", "an empty file"))
    rng = np.random.default_rng(0)
    for at in rng.integers(0, len(whole), 60):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << rng.integers(8)
        saved.write_bytes(bytes(damaged))
        with suppress(InputError):  # some bytes of an archive have no effect
            Motion.load(saved.parent)


def test_archive_bomb_is_refused(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recon.base.documents.MAX_UNPACKED", 1 << 24)
    with zipfile.ZipFile(saved, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("bomb.npy", "w") as member:
        member.write(bytes(1 << 25))
    refuses(saved, ("content", "32 MB"))


def test_false_header_is_refused(saved: Path) -> None:
    made = io.BytesIO()
    np.lib.format.write_array_header_1_0(made, {"descr": "<f8", "fortran_order": False, "shape": (1 << 40,)})
    with zipfile.ZipFile(saved, "a") as archive:
        archive.writestr("huge.npy", made.getvalue())
    refuses(saved, ("content", ["float64", "(1099511627776,)"]))


def test_pickles_are_refused(saved: Path) -> None:
    def change(arrays: dict[str, np.ndarray], record: dict[str, Any]) -> None:
        arrays["solution.states"] = np.array([print], dtype=object)

    rewritten(saved, change)
    refuses(saved, ("content", "array of object"))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda a, r: a.pop("solution.states"), ("content", "'solution.states'")),
        (lambda a, r: cut_states(a, r), ("solution.states", "(7, 28)", "(8, 28)")),
        (lambda a, r: a.update({"solution.states": a["solution.states"][:, 1:]}), ("content", "224 values")),
        (lambda a, r: a.update({"solution.states": np.zeros(9)}), ("content", "stored as float64")),
        (lambda a, r: r["value"]["solution"]["states"].update(stored="<i8"), ("content", "cannot be read")),
        (lambda a, r: r["value"]["solution"]["states"].update(shape=["8", 28]), ("content", "cannot be read")),
        (
            lambda a, r: r["value"]["solution"]["states"].update(shape=[1 << 20, 1 << 20], symmetric=True),
            ("content", "549756338176 values"),
        ),
        (lambda a, r: r["schema"].update(version=9), ("schema", "version 9", "version 4")),
        (lambda a, r: r.update(schema={"name": "other", "version": 1}), ("schema", "other", "recon.motion")),
        (lambda a, r: r.pop("value"), ("content", "'value'")),
        (lambda a, r: r["value"].pop("side"), ("side", "nothing")),
        (lambda a, r: r["value"].update(more=1), ("more", "unknown field", "`recon fit`")),
        (lambda a, r: r["value"].update(side="up"), ("side", "'up'", "'left' or 'right'")),
        (lambda a, r: r["value"]["solution"].update({"class": "os:system"}), ("content", "'os:system'")),
        (lambda a, r: r["value"]["solution"].update({"class": "recon.none:None"}), ("content", "recon.none")),
        (lambda a, r: r["value"]["solution"].update(size="large"), ("size", "'large'", "number")),
        (
            lambda a, r: r["value"]["sources"][0]["camera"].update(model="none"),
            ("sources[0].camera", "", ["model", "'none'"]),
        ),
        (lambda a, r: r["value"].update(sources=[]), ("content", "out of range")),
    ],
)
def test_wrong_content_is_refused(saved: Path, change: Callable[..., Any], expected: tuple[object, ...]) -> None:
    rewritten(saved, change)
    refuses(saved, expected)


def test_solution_of_another_class(saved: Path) -> None:
    rewritten(saved, lambda a, r: r["value"]["solution"].update({"class": "chain"}))
    with pytest.raises(InputError) as caught:
        Motion.load(saved.parent)
    found = {problem.field: problem.found for problem in caught.value.problems}
    assert (found["file"], found["sideslip_sigma_rad"]) == ("nothing", "an unknown field")


@pytest.mark.parametrize("fixture", ["small_motion", "small_trajectory"])
def test_files_name_classes_by_tags(fixture: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    path = request.getfixturevalue(fixture).save(tmp_path)
    with np.load(path) as arrays:
        text = arrays[RECORD].tobytes().decode()
    assert {*re.findall(r'"class": "(.*?)"', text)} <= {*CLASSES}
    assert "recon." not in text.replace('"name": "recon.motion"', "")


@pytest.mark.parametrize(
    ("method", "size", "first_joint_m"),
    [
        ("trajectory", 0.9547427564698026, [-5.5923231342, -0.387887559, 0.4437566273]),
        ("frame", 1.0, [-6.9392279035, -0.0054578535, 0.4552808142]),
    ],
)
def test_motions_of_schema_version_2(method: str, size: float, first_joint_m: list[float], tmp_path: Path) -> None:
    """Motions of schema version 2 are read, although they name classes by modules that no longer exist."""
    motion = Motion.load(FILES / "motions-version-2" / method)
    assert motion.solution.method == method
    assert motion.solution.size == pytest.approx(size, abs=1e-12)
    np.testing.assert_allclose(motion.joints_m[0, 0], first_joint_m, atol=1e-9)
    motion.save(tmp_path)
    assert not differences(motion, Motion.load(tmp_path))


def test_motions_of_schema_version_3(small_trajectory: Motion, tmp_path: Path) -> None:
    """Motions of schema version 3, in which every array is unpacked, are read."""
    path = small_trajectory.save(tmp_path)
    rewritten(path, as_version_3)
    with np.load(path) as arrays:
        np.testing.assert_array_equal(arrays["solution.states"], small_trajectory.solution.states)
    assert not differences(small_trajectory, Motion.load(tmp_path))


def test_folder_without_a_motion_is_refused(tmp_path: Path, small_trajectory: Motion) -> None:
    with refusal(("none", "folder", "no such folder")):
        Motion.load(tmp_path / "none")
    with refusal((tmp_path, "folder", f"no {MOTION}", "recon fit")):
        Motion.load(tmp_path)
    small_trajectory.save(tmp_path / "clip")
    with refusal((tmp_path, "folder", f"no {MOTION}", ["one clip", tmp_path / "clip"])):
        Motion.load(tmp_path)


def test_results_of_an_earlier_version(tmp_path: Path) -> None:
    for name in ("report.json", "config.toml", "pose3d.csv"):
        (tmp_path / name).write_text("{}")
    again = f"recon fit --config {tmp_path}/config.toml --out {tmp_path}"
    with refusal((tmp_path, "folder", "earlier version", again)):
        Motion.load(tmp_path)


def test_motion_of_an_earlier_version(saved: Path) -> None:
    rewritten(saved, lambda arrays, record: record["schema"].update(version=1))
    refuses(saved, ("schema", "version 1", ["version 4", "recon fit"]))
    (saved.parent / "config.toml").write_text("")
    write_manifest(saved.parent)
    again = f"recon fit --config {saved.parent}/config.toml --out {saved.parent} --overwrite"
    refuses(saved, ("schema", "version 1", again))


@dataclasses.dataclass(frozen=True)
class _Leaf:
    values: np.ndarray
    part: slice
    path: Path | None = None


@dataclasses.dataclass(frozen=True)
class _Tree:
    leaves: tuple[_Leaf, ...]
    pairs: dict[str, tuple[int, float]]
    what: str | float | None


def test_dataclass_is_restored(tmp_path: Path) -> None:
    big = np.asfortranarray(np.arange(600, dtype=np.float32).reshape(20, 30))
    leaves = (
        _Leaf(big, slice(1, None), Path("a/b")),
        _Leaf(big, slice(None, 2, 3)),
        _Leaf(np.array([np.nan, -0.0]), slice(0)),
        _Leaf(np.array(7, dtype=np.uint8), slice(0)),
        _Leaf(np.zeros((0, 3), dtype=bool), slice(0)),
    )
    tree = _Tree(leaves, {"a": (1, 0.1), "b": (2, float("inf"))}, "x")
    path = tmp_path / "tree.npz"
    save_record(tree, path, SCHEMA)
    loaded = load_record(_Tree, path, SCHEMA, "a tree")
    assert not differences(tree, loaded)
    with np.load(path) as file:
        assert [*file.files] == ["record", "leaves.0.values"]  # equal arrays are stored once
    with pytest.raises(TypeError, match="what: a set cannot be saved"):
        save_record(replace(tree, what={1}), path, SCHEMA)  # type: ignore[arg-type]


@dataclasses.dataclass(frozen=True)
class _Arrays:
    arrays: tuple[np.ndarray, ...]


def test_arrays_are_stored_small(tmp_path: Path) -> None:
    """Only a triangle of symmetric matrices is stored, equal arrays once, and values in single precision if no bit is
    lost.

    All arrays are restored bit for bit.
    """
    random = np.random.default_rng(0)
    doubles = random.normal(size=(50, 4))
    doubles[3] = np.nan
    matrices = random.normal(size=(50, 2, 3, 3))
    matrices += matrices.swapaxes(-1, -2)
    singles = random.normal(size=(2, 80)).astype(np.float32).astype(float)
    arrays = (doubles, doubles.copy(), matrices, singles, np.asfortranarray(doubles), -0.0 * np.ones((9, 9)))
    save_record(_Arrays(arrays), tmp_path / "a.npz", {"name": "arrays", "version": 1})
    with np.load(tmp_path / "a.npz") as stored:
        shapes = {name: stored[name].shape for name in stored.files if name != RECORD}
    assert shapes == {"arrays.0": (8, 200), "arrays.2": (8, 600), "arrays.3": (4, 160), "arrays.5": (4, 81)}
    loaded = load_record(_Arrays, tmp_path / "a.npz", {"name": "arrays", "version": 1}, "arrays")
    assert not differences(_Arrays(arrays), loaded)
