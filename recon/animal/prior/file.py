"""Files of priors: an .npz without pickles, its texts as JSON."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, Json

from recon.animal.body import Body
from recon.animal.prior.model import ANGLES, NONE, SHAPES, MotionPrior, SegmentRow, misfits, prior_from_body
from recon.animal.skeleton_file import FileTable, parsed_file
from recon.base.documents import read_content
from recon.base.errors import InputError, Problem
from recon.base.package import builtin_file, builtin_names
from recon.base.records import KINDS, MAX_BYTES, arrays_of

_FORMAT = 1
_EXPECTED = "a motion prior, as `recon prior fit` writes it"


class _About(FileTable):
    model_config = ConfigDict(extra="ignore", frozen=True)

    format: Literal[1]
    name: str
    source: str
    angles: list[str]
    segments: list[SegmentRow]


class _Texts(FileTable):
    about: Json[_About]


def builtin_priors() -> tuple[str, ...]:
    """Names of the priors that come with the package."""
    return builtin_names("animal/priors", ".npz")


def save_prior(prior: MotionPrior, path: str | Path) -> None:
    """Write an .npz: the arrays in single precision, the texts as JSON, no pickles."""
    about: dict[str, Any] = {"format": _FORMAT, "name": prior.name, "source": prior.source}
    about |= {"angles": list(prior.angles), "segments": [asdict(row) for row in prior.segments]}
    arrays = {name: getattr(prior, name).astype(np.float32) for name in SHAPES}
    made = io.BytesIO()
    np.savez_compressed(made, about=np.array(json.dumps(about)), **arrays)
    from recon.base.files import staged_file, write_bytes

    with staged_file(Path(path)) as staged:
        write_bytes(staged, made.getvalue())


def load_prior(name_or_path: str | Path | None, body: Body) -> MotionPrior:
    """The built-in prior of that name, or the one in a file; "none": `prior_from_body`. None: the built-in one for a
    body with these angles, or else that of the body.

    Raises InputError, naming every problem: no such name or file, no prior, or one for other angles than the body's.
    """
    if name_or_path is None:
        for name in builtin_priors():
            with suppress(InputError):  # it is another animal's
                return load_prior(name, body)
    if name_or_path is None or str(name_or_path) == NONE:
        return prior_from_body(body)
    if str(name_or_path) in builtin_priors():
        content = builtin_file("animal/priors", f"{name_or_path}.npz").read_bytes()
        return _prior(content, f"prior {name_or_path}", body)
    path = Path(name_or_path)
    if not path.is_file():
        expected = f"one of {', '.join((*builtin_priors(), NONE))}, or a prior file (.npz)"
        raise InputError(Problem("--prior", "name or file", repr(str(name_or_path)), expected))
    return _prior(read_content(path, _EXPECTED, MAX_BYTES), str(path), body)


def _prior(content: bytes, source: str, body: Body) -> MotionPrior:
    try:
        stored = arrays_of(content, f"{KINDS}U")
        text = str(stored["about"]) if "about" in stored else ""
    except ValueError as error:
        raise InputError(Problem(source, "file", f"none that can be read ({error})", _EXPECTED)) from None
    lacking = [key for key in ("about", *SHAPES) if key not in stored]
    if lacking:
        raise InputError([Problem(source, key, "nothing", _EXPECTED) for key in lacking])
    texts, problems = parsed_file(_Texts, {"about": text}, source)
    about, arrays = None if texts is None else texts.about, {}
    for key in SHAPES:
        if stored[key].dtype.kind == "f":
            with np.errstate(invalid="ignore"):  # a NaN that signals, as damaged floats can be
                arrays[key] = stored[key].astype(float)
        else:
            problems.append(Problem(source, key, f"an array of {stored[key].dtype}", "floating-point numbers"))
    if about is not None and about.angles != list(body.state_names[ANGLES]):
        problems.append(_other_angles(about.angles, body, source))
    elif about is not None and len(arrays) == len(SHAPES):
        found = misfits(arrays, len(about.angles))
        problems += [Problem(source, field, what, expected) for field, what, expected in found]
    if about is None or problems:
        raise InputError(problems)
    for key in ("covariances", "covariance", "acceleration_covariance"):
        arrays[key] = (arrays[key] + arrays[key].swapaxes(-1, -2)) / 2
    arrays["weights"] = arrays["weights"] / arrays["weights"].sum()
    return MotionPrior(about.name, tuple(about.angles), **arrays, source=about.source, segments=tuple(about.segments))


def _other_angles(angles: Sequence[str], body: Body, source: str) -> Problem:
    expected = body.state_names[ANGLES]
    differing = {
        "missing": [name for name in expected if name not in angles],
        "of another body": [name for name in angles if name not in expected],
    }
    parts = [f"{len(names)} {what} ({', '.join(names[:3])})" for what, names in differing.items() if names]
    found = f"{len(angles)} angles, {' and '.join(parts) or 'in another order'}"
    return Problem(source, "angles", found, f"the {len(expected)} angles of {body.name}, in its order")
