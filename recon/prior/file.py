"""Files of priors: an .npz without pickles, its texts as JSON."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from recon.body import Body
from recon.errors import InputError, Problem
from recon.files import staged_file, write_bytes
from recon.package import builtin_file, builtin_names
from recon.prior.model import ANGLES, NONE, SHAPES, MotionPrior, SegmentRow, misfits, prior_from_body

_FORMAT = 1
_EXPECTED = "a motion prior, as `recon prior fit` writes it"


def builtin_priors() -> tuple[str, ...]:
    """Names of the priors that come with the package."""
    return builtin_names("priors", ".npz")


def save_prior(prior: MotionPrior, path: str | Path) -> None:
    """Write an .npz: the arrays in single precision, the texts as JSON, no pickles."""
    about: dict[str, Any] = {
        "format": _FORMAT,
        "name": prior.name,
        "source": prior.source,
        "angles": list(prior.angles),
    }
    about["segments"] = [asdict(row) for row in prior.segments]
    arrays = {name: getattr(prior, name).astype(np.float32) for name in SHAPES}
    made = io.BytesIO()
    np.savez_compressed(made, about=np.array(json.dumps(about)), **arrays)
    with staged_file(Path(path)) as staged:
        write_bytes(staged, made.getvalue())


def load_prior(name_or_path: str | Path, body: Body) -> MotionPrior:
    """The built-in prior of that name, or the one in a file; "none": `prior_from_body`.

    Raises InputError, naming every problem: no such name or file, no prior, or one for other angles than the body's.
    """
    if str(name_or_path) == NONE:
        return prior_from_body(body)
    if str(name_or_path) in builtin_priors():
        content = builtin_file("priors", f"{name_or_path}.npz").read_bytes()
        return _prior(content, f"prior {name_or_path}", body)
    path = Path(name_or_path)
    if not path.is_file():
        expected = f"one of {', '.join((*builtin_priors(), NONE))}, or a prior file (.npz)"
        raise InputError(Problem("--prior", "name or file", repr(str(name_or_path)), expected))
    return _prior(path.read_bytes(), str(path), body)


def _prior(content: bytes, source: str, body: Body) -> MotionPrior:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            stored = {key: file[key] for key in file.files}
    except Exception as error:
        # A damaged file surfaces as almost any exception of zip and numpy.
        raise InputError(Problem(source, "file", f"none that can be read ({error})", _EXPECTED)) from None
    lacking = [key for key in ("about", *SHAPES) if key not in stored]
    if lacking:
        raise InputError([Problem(source, key, "nothing", _EXPECTED) for key in lacking])
    about, problems = _texts(stored["about"], source)
    arrays = {}
    for key in SHAPES:
        if stored[key].dtype.kind == "f":
            arrays[key] = stored[key].astype(float)
        else:
            problems.append(Problem(source, key, f"an array of {stored[key].dtype}", "floating-point numbers"))
    if about is not None and list(about["angles"]) != list(body.state_names[ANGLES]):
        problems.append(_other_angles(about["angles"], body, source))
    elif about is not None and len(arrays) == len(SHAPES):
        found = misfits(arrays, len(about["angles"]))
        problems += [Problem(source, field, what, expected) for field, what, expected in found]
    if about is None or problems:
        raise InputError(problems)
    for key in ("covariances", "covariance", "acceleration_covariance"):
        arrays[key] = (arrays[key] + arrays[key].swapaxes(-1, -2)) / 2
    arrays["weights"] = arrays["weights"] / arrays["weights"].sum()
    segments = tuple(SegmentRow(**row) for row in about["segments"])
    return MotionPrior(about["name"], tuple(about["angles"]), **arrays, source=about["source"], segments=segments)


def _texts(stored: np.ndarray, source: str) -> tuple[dict | None, list[Problem]]:
    """The texts of a file, None where they are not as they should be."""
    try:
        about = json.loads(str(stored))
    except json.JSONDecodeError:
        return None, [Problem(source, "about", repr(str(stored))[:60], "JSON")]
    if not isinstance(about, dict) or about.get("format") != _FORMAT:
        found = repr(about.get("format")) if isinstance(about, dict) else repr(about)[:60]
        return None, [Problem(source, "about.format", found, f"{_FORMAT}")]
    kinds = (
        ("name", "a text", str, None),
        ("source", "a text", str, None),
        ("angles", "a list of names", list, str),
        ("segments", "a list of tables", list, dict),
    )
    problems = [
        Problem(source, f"about.{key}", repr(about.get(key))[:60], what)
        for key, what, kind, item in kinds
        if not isinstance(about.get(key), kind) or (item and not all(isinstance(one, item) for one in about[key]))
    ]
    if not problems:
        expected = [field.name for field in fields(SegmentRow)]
        problems = [
            Problem(source, f"about.segments.{i}", ", ".join(row), ", ".join(expected))
            for i, row in enumerate(about["segments"])
            if list(row) != expected
        ]
    return None if problems else about, problems


def _other_angles(angles: Sequence[str], body: Body, source: str) -> Problem:
    expected = body.state_names[ANGLES]
    differing = (
        ("missing", [name for name in expected if name not in angles]),
        ("of another body", [name for name in angles if name not in expected]),
    )
    parts = [
        f"{len(names)} {what} ({', '.join(names[:3])}{', ...' * (len(names) > 3)})"
        for what, names in differing
        if names
    ]
    found = f"{len(angles)} angles, {' and '.join(parts) or 'in another order'}"
    return Problem(source, "angles", found, f"the {len(expected)} angles of {body.name}, in its order")
