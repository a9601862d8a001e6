"""Damage files: bytes, lines and cells, values of JSON and TOML, datasets of HDF5, arrays of an archive.

All damage is drawn from one random generator, so the same seed gives the same file again.
"""

from __future__ import annotations

import io
import json
import os
import re
import tomllib
import zipfile
from collections.abc import Callable
from random import Random
from typing import Any

import h5py
import numpy as np
import tomli_w

ODD_NUMBERS = (
    *("0", "-0", "-1", "1e308", "-1e308", "1e-320", "inf", "-inf", "nan", "1_000.5", "0x10", "1e400", "65536", "0.5"),
    *("2147483648", "-9223372036854775809", "18446744073709551616", "1" * 5000, "１", "", " ", "x", "1,5", "1e", "--1"),
)
ODD_TEXTS = (
    *("", " ", "a" * 300, "\0", "ä", "\ufeff", "\u202e", "../../etc/passwd", "/dev/zero", "$t_{$", "x[/b]", "\x1b[31m"),
    *(
        "con",
        "a." * 3000,
        "nan",
        "true",
        "[" * 3000,
        "{" * 3000,
        '"',
        "'",
        "\\",
        "#",
        ";",
        "\t",
        "a\nb",
        "\r",
        "<!--",
        "&x;",
    ),
)
ODD_TEXTS += ("../precious.csv", "..", "mine.csv", "link.csv", "d.csv", "analysis", ".recon.json", "manifest.json")
ODD_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 0.5, 1e308, -1e308, 1e-320, 2**31, 2**63, 2**64, -(2**63) - 1, 10**30),
    *(float("inf"), float("-inf"), float("nan"), "", "x", "0", "nan", "a" * 300, "\0", "\x1b[31m", "ä"),
    *([], [[]], [0], [0, 0, 0], [1e308] * 3, ["a", "a"], {}, {"a": 1}, [{}], [None], "[" * 100),
)
ODD_BYTES = (0x00, 0x01, 0x0A, 0x0D, 0x20, 0x22, 0x2C, 0x5B, 0x7F, 0x80, 0xC3, 0xFF)
ODD_WORDS = (
    b"\xff" * 8,
    bytes(8),
    b"\xff\xff\xff\x7f",
    b"\x00\x00\x00\x80",
    b"\xff\xff",
    (2**62).to_bytes(8, "little"),
)
LONG_CELL = "1" * 131_073
"""Cell with more characters than Python's csv module accepts."""
MOST = 1 << 18
"""Largest size of a damaged text, bytes; longer texts take more time and show nothing else."""


def spoilt(content: bytes, suffix: str, random: Random) -> bytes:
    """Damage the content of a file once or several times, in ways that suit its suffix."""
    kinds = KINDS.get(suffix, (lines, lines, numbers, words, in_bytes))
    chosen = [random.choice(kinds) for _ in range(random.choice((1, 1, 1, 2, 3, 6)))]
    # Damage bytes last, because libraries must not open files with damaged bytes before recon's readers do.
    chosen.sort(key=lambda mutation: mutation in BINARY)
    for mutation in chosen:
        try:
            content = mutation(content, random)
        except Exception:
            content = in_bytes(content, random)  # an earlier mutation left a file that this mutation cannot parse
    return content


ODD_PARTS = (
    b"caf\xe9",
    b"\xff\xfe",
    b"\\xe9",
    b"\n",
    b"\x1b[31m",
    b"=1+1",
    b"-",
    b" ",
    b"'",
    b'"',
    b"%s",
    b"{0}",
    b"[bold]",
    b"$HOME",
)
ODD_PARTS += (b"\r", b"\x07", b"\x7f", b"\xc2\x9b", b"CON", b"NUL.", b"\xd0\xb0", b"@SUM(1)", b"+1")
ODD_PARTS += (b"\t", b"--out", b"~", b"\xc2\xa0", b"\xe2\x80\xa8")
ODD_PARTS += (b"&<b>", b"#", b";", b",", b"*", b"..", b"\xf0\x9f\x90\x86", b"\xe2\x80\xae", b"e\xcc\x81", b"a" * 180)
"""In the names of files."""


def spoilt_name(name: str, random: Random) -> str:
    """Return a file's name, usually unchanged and sometimes with odd bytes in front."""
    if random.random() < 0.8:
        return name
    parts = random.choices(ODD_PARTS, k=random.choice((1, 1, 2)))
    return os.fsdecode(b"".join(parts)[-200:]) + name


def in_bytes(content: bytes, random: Random) -> bytes:
    made = bytearray(content)
    for _ in range(random.choice((1, 1, 2, 8, 32))):
        # Damage headers more often than data, since readers depend on them.
        at = random.randrange(min(len(made), random.choice((512, 8192, len(made) or 1))) or 1)
        what = random.randrange(6)
        if what == 0:
            made[at : at + 1] = bytes([random.randrange(256)])
        elif what == 1:
            made[at : at + 1] = bytes([random.choice(ODD_BYTES)])
        elif what == 2:
            word = random.choice(ODD_WORDS)
            made[at : at + len(word)] = word
        elif what == 3:
            made[at : at + 8] = random.randrange(max(len(made), 1)).to_bytes(8, "little")
        elif what == 4:
            n, other = random.randrange(1, 64), random.randrange(max(len(made), 1))
            made[at : at + n] = made[other : other + n]
        elif at < len(made):
            made[at] ^= 1 << random.randrange(8)
    return bytes(made)


def cut(content: bytes, random: Random) -> bytes:
    at = random.randrange(len(content) + 1)
    return content[:at] if random.random() < 0.7 else content[at:]


def replaced(content: bytes, random: Random) -> bytes:
    """Replace a content by nothing, a part of it, a repetition, or unrelated bytes."""
    other = (b"", b"\0", content[:8] + bytes(2000), b"[" * 50_000, b"\xff\xfe" + content, content * 2, content[::-1])
    return random.choice(other)


def _text(content: bytes) -> str:
    return content.decode("utf-8", errors="surrogateescape")[:MOST]


def _encoded(text: str, random: Random) -> bytes:
    if random.random() < 0.03:
        return text.encode(random.choice(("utf-16", "utf-8-sig", "latin-1")), errors="replace")
    return text.encode("utf-8", errors="surrogateescape")


def lines(content: bytes, random: Random) -> bytes:
    rows = _text(content).splitlines(keepends=True) or [""]
    at, other = random.randrange(min(len(rows), random.choice((6, len(rows))))), random.randrange(len(rows))
    what = random.randrange(9)
    if what == 0:
        del rows[at]
    elif what == 1:
        rows.insert(at, rows[other])
    elif what == 2:
        rows[at], rows[other] = rows[other], rows[at]
    elif what == 3:
        rows[at] = rows[at][: random.randrange(len(rows[at]) + 1)]
    elif what == 4:
        rows.insert(at, random.choice(ODD_TEXTS) + "\n")
    elif what == 5:
        rows[at] = rows[at].replace(random.choice(",;=: \t."), random.choice(",;=: \t."))
    elif what == 6:
        rows = [row.replace("\n", random.choice(("\r", "\r\n", "\n\n"))) for row in rows]
    elif what == 7:
        cells = rows[at].split(",")
        cells[random.randrange(len(cells))] = random.choice((*ODD_TEXTS, *ODD_NUMBERS, LONG_CELL))
        rows[at] = ",".join(cells)
    else:
        rows = rows[:at] + rows[other:]
    return _encoded("".join(rows), random)


def numbers(content: bytes, random: Random) -> bytes:
    """Replace one number, or all numbers equal to it, by an unusual number."""
    text = _text(content)
    found = list(re.finditer(r"-?\d+(\.\d+)?([eE][-+]?\d+)?", text))
    if not found:
        return words(content, random)
    match = random.choice(found)
    odd = random.choice(ODD_NUMBERS)
    if random.random() < 0.2 and len(match[0]) > 1:
        return _encoded(text.replace(match[0], odd)[:MOST], random)
    return _encoded(text[: match.start()] + odd + text[match.end() :], random)


def words(content: bytes, random: Random) -> bytes:
    text = _text(content)
    found = list(re.finditer(r"[A-Za-z_]+", text))
    if not found:
        return random.choice(ODD_TEXTS).encode() + content
    match, other = random.choice(found), random.choice(found)
    with_ = random.choice((other[0], other[0], random.choice(ODD_TEXTS)))
    if random.random() < 0.2:
        return _encoded(text.replace(match[0], with_)[:MOST], random)
    return _encoded(text[: match.start()] + with_ + text[match.end() :], random)


def _altered(value: Any, random: Random) -> Any:
    """Replace, remove, double or exchange one part of a JSON or TOML value."""
    holders = [h for h in _holders(value) if h]
    if not holders:
        return random.choice(ODD_VALUES)
    holder = random.choice(holders)
    keys: list[Any] = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
    key, other = random.choice(keys), random.choice(keys)
    what = random.randrange(5)
    if what == 0:
        del holder[key]
    elif what == 1 and isinstance(holder, list):
        holder.insert(key, holder[other])
    elif what == 1:
        holder[random.choice(ODD_TEXTS)] = holder.pop(key)
    elif what == 2:
        holder[key], holder[other] = holder[other], holder[key]
    else:
        holder[key] = random.choice(ODD_VALUES)
    return value


def _holders(value: Any) -> list[Any]:
    if not isinstance(value, dict | list):
        return []
    inside = value.values() if isinstance(value, dict) else value
    return [value, *(holder for item in inside for holder in _holders(item))]


def in_json(content: bytes, random: Random) -> bytes:
    return json.dumps(_altered(json.loads(content), random)).encode()


def in_toml(content: bytes, random: Random) -> bytes:
    return tomli_w.dumps(_altered(tomllib.loads(content.decode()), random)).encode("utf-8", errors="surrogateescape")


def _odd_array(array: np.ndarray, random: Random) -> np.ndarray:
    """Change the shape, type or content of an array."""
    what = random.randrange(9)
    if what == 0:
        return array[:0] if array.ndim else np.zeros(0)
    if what == 1:
        return array[None]
    if what == 2 and array.ndim:
        return array[..., :-1]
    if what == 3:
        return np.array(random.choice((0.0, 1, -1, np.inf, np.nan)))
    if what == 4:
        return np.array([b"a", b"\xff", b""])
    if what == 5 and array.dtype.kind in "fiu":
        return array.astype(random.choice(("f4", "i8", "u1", "f8", "?", "S8", "c16")))
    if what == 6 and array.ndim:
        return array.T
    if array.size and array.dtype.kind in "fiu":
        made = array.astype(float).ravel()
        for _ in range(random.choice((1, 3))):
            made[random.randrange(made.size)] = random.choice(
                (np.nan, np.inf, -np.inf, -1, 0, 1e308, 1e-320, 2**53, 0.5)
            )
        return made.reshape(array.shape)
    return np.zeros((2, 3), random.choice(("f8", "i4", "S3")))


def in_hdf5(content: bytes, random: Random) -> bytes:
    """Alter, remove or move one dataset or attribute."""
    stream = io.BytesIO(content)
    with h5py.File(stream, "a") as file:
        found: list[Any] = [file]
        file.visititems(lambda _, item: found.append(item))
        item: Any = random.choice(found)
        if isinstance(item, h5py.Dataset) and (item.size or 0) < MOST and random.random() < 0.6:
            name, values = str(item.name), item[()] if item.shape is not None else np.zeros(0)
            del file[name]
            if random.random() < 0.8:
                file[name] = _odd_array(np.asarray(values), random)
            elif random.random() < 0.5:
                file[name] = h5py.SoftLink(random.choice(("/", name, "/none", str(found[-1].name))))
            else:
                file.create_dataset(name, (2**20, 2**20), "f8", chunks=(64, 64))
        elif item is not file and random.random() < 0.15:
            file.move(str(item.name), random.choice(("other", "tracks", "position", f"{item.name}2")))
        elif len(item.attrs):
            key = random.choice(sorted(item.attrs))
            odd = random.choice(
                (0, -1, 1.5, np.nan, "x", "", "é", np.bytes_(b"N."), np.bytes_(b"(lp0\n."), [1, 2], 2**40)
            )
            del item.attrs[key]
            if random.random() < 0.8:
                item.attrs[key] = odd
    return stream.getvalue()


def in_npz(content: bytes, random: Random) -> bytes:
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    name = random.choice(sorted(arrays))
    what = random.random()
    if what < 0.15:
        del arrays[name]
    elif what < 0.4 and arrays[name].dtype.kind == "U" and not arrays[name].ndim:
        arrays[name] = np.array(in_json(str(arrays[name]).encode(), random).decode())
    else:
        arrays[name] = _odd_array(arrays[name], random)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def in_zip(content: bytes, random: Random) -> bytes:
    """Alter the bytes of one file of an archive with a correct checksum, or state a wrong size."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {info: archive.read(info) for info in archive.infolist()}
    chosen = random.choice(list(files))
    files[chosen] = in_bytes(files[chosen], random)
    if random.random() < 0.3:
        files[chosen] = numbers(files[chosen], random)
    stream = io.BytesIO()
    methods = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) * 4 + (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    with zipfile.ZipFile(stream, "w", random.choice(methods)) as archive:
        for info, own in files.items():
            archive.writestr(info.filename, own)
    made = bytearray(stream.getvalue())
    if random.random() < 0.2:
        at = made.find(b"PK\x01\x02") + 24
        made[at : at + 4] = random.choice((0, 1, 100, 1 << 29, 0xFFFFFFFE)).to_bytes(4, "little")
    return bytes(made)


Mutation = Callable[[bytes, Random], bytes]
BINARY: tuple[Mutation, ...] = (in_bytes, in_bytes, in_bytes, cut, replaced)
TEXT: tuple[Mutation, ...] = (lines, lines, numbers, numbers, words, in_bytes, cut, replaced)
KINDS: dict[str, tuple[Mutation, ...]] = {
    **dict.fromkeys((".h5", ".nc", ".nwb"), (*BINARY, *BINARY, *((in_hdf5,) * 6))),
    **dict.fromkeys((".c3d", ".parquet", ".cdf"), BINARY),
    ".npz": (*BINARY, *(in_npz,) * 6, *(in_zip,) * 4),
    ".pt": (*BINARY, *(in_zip,) * 4),
    ".json": (*TEXT, *(in_json,) * 8),
    ".toml": (*TEXT, *(in_toml,) * 8),
    **dict.fromkeys((".csv", ".trc", ".bvh", ".yml", ".xml", ".urdf", ".txt"), TEXT),
}
