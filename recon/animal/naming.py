"""Translate the keypoint names of a detector into the names of a skeleton's keypoints, given a name map.

A name map is a CSV file with two columns: the name in the keypoint file, and the name in the skeleton. If the second
cell is empty, the keypoint is left out. Built-in maps are the files in `recon/animal/names`.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import SequenceMatcher
from functools import cached_property
from pathlib import Path
from typing import TypeVar, overload

from recon.animal.body import SIDE_WORD, SIDES, opposite_word, side_of
from recon.animal.skeleton_file import builtin_names, load_skeleton
from recon.base import documents
from recon.base.errors import InputError, Problem, raise_problems
from recon.clip import Keypoints

HEADER = ("file", "skeleton")
"""Optional first row of a name map."""
_EXPECTED = "a CSV file with two columns: a keypoint's name in the file, and the skeleton's"
_SAME_WORDS: dict[str, str] = {
    "thai": "thigh",
    **dict.fromkeys(("fore", "f", "thoracic", "forelimb", "foreleg"), "front"),
    **dict.fromkeys(("hind", "rear", "b", "h", "pelvic", "hindlimb", "hindleg"), "back"),
    **dict.fromkeys(("foot", "hoof", "hand"), "paw"),
    "root": "base",
    "carpi": "carpus",
    "tarsi": "tarsus",
    "stiffle": "stifle",
}
"""Synonyms and common misspellings in keypoint names, each with the word that replaces it."""
_LIMB_OF = {
    **dict.fromkeys(("shoulder", "elbow", "carpus", "wrist"), "front"),
    **dict.fromkeys(("hip", "stifle", "hock", "tarsus"), "back"),
}
"""Joints that occur only in the fore or only in the hind limbs, each with the word for these limbs."""
_LEG_WORDS = {*_LIMB_OF, "paw", "foot", "hoof", "hand", "knee", "ankle", "toe", "fetlock", "stiffle"}
"""Words for parts of a leg before which a letter may mean fore or hind, as in LFpaw and RHhock."""
_SEPARATORS = "_-. "
_FILLERS = {"of", "the", "limb"}
"""Words that are ignored when keypoint names are compared."""
ANATOMICAL = "anatomical"
"""Name of the built-in name map for veterinary terms."""
_NEAR = 0.8
"""Similarity of two names, from 0 to 1, above which they are suggested as names of the same keypoint."""
_MOST_OF_FILE = 0.8
"""Minimum fraction of a file's keypoints that a skeleton must have to be suggested for this file."""


_Default = TypeVar("_Default")


@dataclass(frozen=True)
class NameMap:
    """Map from the keypoint names in a file to the names in a skeleton."""

    source: str
    """Name of the built-in map, or path of the map's file."""
    names: Mapping[str, str]
    """The skeleton's name for each name in the file; empty for keypoints that are left out."""

    @overload
    def get(self, name: str) -> str | None: ...

    @overload
    def get(self, name: str, otherwise: _Default) -> str | _Default: ...

    def get(self, name: str, otherwise: _Default | None = None) -> str | _Default | None:
        """Return the skeleton's name for a keypoint of the file, or `otherwise`.

        A built-in map accepts any spelling of a name's side and words, such as left_carpus, LeftCarpus and carpus_L.
        """
        return self.names.get(name, self._by_words.get(_side_and_words(name), otherwise))

    @cached_property
    def _by_words(self) -> dict[tuple[str | None, ...], str]:
        return {_side_and_words(name): new for name, new in self.names.items() if self.source in builtin_maps()}

    def common(self, names: Iterable[str], wanted: Iterable[str]) -> int:
        """Return the number of the wanted names that are present after the map has been applied to `names`."""
        return len({self.get(name, name) for name in names} & {*wanted})


def builtin_maps() -> tuple[str, ...]:
    """Return the names of the built-in name maps."""
    return documents.builtin_names("animal/names", ".csv")


def load_names(name_or_path: str | Path) -> NameMap:
    """Load a name map by its built-in name or from a CSV file.

    Raises
    ------
    InputError
        If the file is not a name map. The error lists every problem.
    """
    source = str(name_or_path)
    content, _ = documents.named_file(name_or_path, "animal/names", ".csv", "--rename", "map of names")
    text = documents.text_of(content, source, _EXPECTED)
    lines = [(i, line) for i, line in enumerate(text.splitlines(), start=1) if line.strip() and line.strip()[0] != "#"]
    delimiter = next((mark for mark in ",;\t" if lines and mark in lines[0][1]), ",")
    names: dict[str, str] = {}
    problems = []
    for i, line in lines:
        cells = _cells(line, delimiter)
        if len(cells) != 2 or not cells[0] or not "".join(cells).isprintable():
            problems.append(Problem(source, f"line {i}", repr(line)[:60], _EXPECTED))
        elif cells[0] in names:
            problems.append(
                Problem(source, f"line {i}", f"{cells[0]!r} a second time", "each name of the file only once")
            )
        elif tuple(cells) != HEADER or names:
            names[cells[0]] = cells[1]
    if not names and not problems:
        problems = [Problem(source, "lines", "no names", _EXPECTED)]
    raise_problems(problems)
    return NameMap(source, names)


def _cells(line: str, delimiter: str) -> list[str]:
    try:
        return [cell.strip() for row in csv.reader([line], delimiter=delimiter) for cell in row]
    except csv.Error:  # a cell is larger than the csv module accepts, 128 kB
        return []


def renamed(keypoints: Keypoints, name_map: NameMap) -> Keypoints:
    """Return keypoints with the names of a skeleton, and with a note that states which keypoints were renamed.

    Raises
    ------
    InputError
        If the map does not fit the names (`new_names`).
    """
    keep, names, note = new_names(keypoints.names, name_map, keypoints.source or "the keypoints")
    return replace(
        keypoints,
        names=names,
        xy_px=keypoints.xy_px[:, keep],
        confidence=keypoints.confidence[:, keep],
        notes=(*keypoints.notes, note),
    )


def new_names(names: Sequence[str], name_map: NameMap, source: str) -> tuple[list[int], tuple[str, ...], str]:
    """Return the indices of the keypoints that are kept, their new names, and a note that states which were renamed.

    `source` is the name of the keypoint file in error messages.

    Raises
    ------
    InputError
        If none of the map's names is in the file, two keypoints would have the same name, or no keypoint is kept.
    """
    known = [name for name in names if name_map.get(name) is not None]
    if not known:
        detail = f"{', '.join(name_map.names)}: none of them in {source}"
        raise InputError(Problem(name_map.source, "names", detail, f"at least one of {', '.join(names)}"))
    old_names_by_new: dict[str, list[str]] = {}
    for name in names:
        old_names_by_new.setdefault(name_map.get(name, name) if name in known else name, []).append(name)
    left_out = old_names_by_new.pop("", [])
    problems = [
        Problem(name_map.source, "names", f"{new!r} for {', '.join(several)}", "this new name for only one keypoint")
        for new, several in old_names_by_new.items()
        if len(several) > 1
    ]
    if not old_names_by_new:
        problems = [Problem(name_map.source, "names", f"every keypoint of {source} left out", "at least one new name")]
    raise_problems(problems)
    note = f"{len(known)} of {len(names)} keypoints are renamed by {Path(name_map.source).name}"
    note += f"; left out: {', '.join(left_out)}" if left_out else ""
    absent = [] if name_map.source in builtin_maps() else [name for name in name_map.names if name not in names]
    note += f"; not in the file: {', '.join(absent)}." if absent else "."
    return [k for k, name in enumerate(names) if name not in left_out], tuple(old_names_by_new), note


def suggestions(unused: Iterable[str], missing: Iterable[str]) -> dict[str, str]:
    """Suggest a similar missing name for each unused name, as a dictionary that begins with the most similar pair.

    Unused names without a similar missing name are left out. Every missing name is suggested at most once.
    """
    pairs = [(likeness, a, b) for a in unused for b in missing if (likeness := _likeness(a, b)) >= _NEAR]
    matches: dict[str, str] = {}
    for _, a, b in sorted(pairs, key=lambda pair: -pair[0]):
        if a not in matches and b not in matches.values():
            matches[a] = b
    return matches


def fitting_maps(names: Sequence[str], wanted: Iterable[str]) -> list[str]:
    """Return the names of the built-in maps that increase the number of wanted names, the best map first."""
    wanted = {*wanted}
    shares = {name: load_names(name).common(names, wanted) for name in builtin_maps()}
    better = [name for name, fraction in shares.items() if fraction > len({*names} & wanted)]
    return sorted(better, key=lambda name: -shares[name])


def fitting_skeleton(names: Sequence[str]) -> tuple[str, int]:
    """Return the options for the built-in skeleton that matches the most keypoint names, and the number of matches.

    The options include a name map if it helps, such as `--skeleton human-25 --rename coco-17`.
    """
    (skeleton, name_map), count = _best_skeleton(names)
    return f"--skeleton {skeleton}{name_map.source and ' --rename '}{name_map.source}", count


def marker_names(names: Sequence[str]) -> tuple[str | None, dict[str, int]]:
    """Return the built-in skeleton that matches the most keypoint names, and a dictionary of the keypoints' indices.

    The keys are the skeleton's markers. Names are compared unchanged and after each built-in name map. The skeleton is
    None if no name matches.
    """
    (skeleton, name_map), count = _best_skeleton(names)
    if not count:
        return None, {}
    markers = {*_whole_animals()[skeleton]}
    indices = {name_map.get(name, name): i for i, name in reversed([*enumerate(names)])}
    return skeleton, {marker: i for marker, i in indices.items() if marker in markers}


def _best_skeleton(names: Sequence[str]) -> tuple[tuple[str, NameMap], int]:
    """Return the built-in skeleton and name map that match the most keypoint names, and the number of matches."""
    maps = [NameMap("", {}), *map(load_names, builtin_maps())]
    counts = [
        ((skeleton, name_map), name_map.common(names, markers))
        for skeleton, markers in _whole_animals().items()
        for name_map in maps
    ]
    return max(counts, key=lambda entry: entry[1])


def _whole_animals() -> dict[str, tuple[str, ...]]:
    """Return the markers of each built-in skeleton of a whole animal, with the skeletons' names as keys."""
    from recon.animal.chain import builtin_chains  # imported here because few clips use a chain

    chains = builtin_chains()
    return {name: load_skeleton(name).markers for name in builtin_names() if name not in chains}


def problem_of_names(names: Sequence[str], wanted: Sequence[str], skeleton: str, source: str) -> Problem:
    """Return a problem which states that a file's keypoint names differ from the skeleton's, with a remedy.

    The remedy is another skeleton, a built-in name map or, if no built-in map has every name, the lines of a new map.
    """
    detail = f"{', '.join(names)}: {', '.join(name for name in names if name in wanted) or 'none'} in the skeleton"
    if matching := skeleton_of(names):
        return Problem(source, "bodyparts", detail, f"the skeleton of these names: --skeleton {matching}")
    maps, (options, count) = fitting_maps(names, wanted), fitting_skeleton(names)
    count_here = load_names(maps[0]).common(names, {*wanted}) if maps else 0
    if count >= _MOST_OF_FILE * len(names) and count > count_here and f"--skeleton {skeleton} " not in f"{options} ":
        hint = f"{options}, or"
    else:
        fits = maps and 2 * count_here >= min(len(names), len(wanted))
        hint = f"--rename {maps[0]}, or" if fits else "another animal's --skeleton, or"
        if maps and count_here == len(names):
            return Problem(
                source, "bodyparts", detail, f"the names of the skeleton {skeleton}: give --rename {maps[0]}"
            )
    expected = (
        f"the names of the skeleton {skeleton}: {', '.join(wanted)}; give {hint} --rename with a file of these lines, "
    )
    return Problem(source, "bodyparts", detail, f"{expected}completed", tuple(map_to_write(names, wanted)))


def map_to_write(names: Iterable[str], wanted: Iterable[str]) -> Iterator[str]:
    """Yield the lines of a new name map for a file's keypoint names, filled in where a wanted name is similar.

    Names that the best built-in map, or the one of veterinary terms, contains are also filled in.
    """
    names, wanted = list(names), list(wanted)
    unused, missing = [n for n in names if n not in wanted], [w for w in wanted if w not in names]
    best = [load_names(name_map).get for name_map in fitting_maps(names, wanted)[:1]]
    near: dict[str, str] = {}
    for marker_of in (suggestions(unused, missing).get, *best, load_names(ANATOMICAL).get):
        for name in unused:
            marker = marker_of(name)
            if marker in missing and name not in near and marker not in near.values():
                near[name] = marker
    yield ",".join(HEADER)
    yield from (f"{name},{near.get(name, '')}" for name in names if name not in wanted)


def _likeness(a: str, b: str) -> float:
    """Return the similarity of two keypoint names from 0 to 1; 0 for names of different sides."""
    if side_of(a) != side_of(b):
        return 0.0
    if _side_and_words(a) == _side_and_words(b):
        return 1.0
    words_a, words_b = _words(a), _words(b)
    if ({*words_a} ^ {*words_b}) & {"front", "back"}:
        return 0.0
    return SequenceMatcher(None, "".join(words_a), "".join(words_b), autojunk=False).ratio()


def _side_and_words(name: str) -> tuple[str | None, ...]:
    """Return the side and the words of a keypoint name in a fixed order, in lower case."""
    return side_of(name), *sorted(_words(name))


def _words(name: str) -> list[str]:
    """Return the words of a keypoint name without its side, in lower case, such as base and tail for rootOfTail.

    Words that another word implies are left out, such as front in LF_carpus and tip in hoof_tip.
    """
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[0-9]+|[^\W\d_a-zA-Z]+", without_side(name))
    whole = [word.lower() for word in words]
    lower: list[str] = []
    for word in whole:
        is_code = word[:1] in ("f", "h", "b") and word[1:] in _LEG_WORDS
        lower += [word[0], word[1:]] if is_code else [word]
    same = [_SAME_WORDS.get(word, word) for word in lower if word not in _FILLERS]
    implied = {_LIMB_OF[word] for word in same if word in _LIMB_OF} | ({"tip"} if "paw" in same else set())
    return [word for word in same if word not in implied]


def without_side(name: str) -> str:
    """Return a name without its side, such as front_paw for front_left_paw, or the same name if it has no side."""
    word = SIDE_WORD.search(name)
    if word is None:
        return name
    start, rest = name[: word.start()], name[word.end() :]
    if not start or start[-1] in _SEPARATORS:
        rest = rest.lstrip(_SEPARATORS)
    return (start + rest if rest else start.rstrip(_SEPARATORS)) or name


def both_sides(name: str) -> str:
    """Return a name for both sides, such as l/r_paw for l_paw or r_paw, or the same name if it has no side."""
    word = SIDE_WORD.search(name)
    if word is None:
        return name
    left, right = sorted((word[0], opposite_word(word[0])), key=lambda side: side.lower() not in SIDES)
    return f"{name[: word.start()]}{left}/{right}{name[word.end() :]}"


def skeleton_of(keypoints: Iterable[str]) -> str | None:
    """Return the name of the largest built-in skeleton whose markers are all among the given keypoints, or None."""
    names = {*keypoints}
    fitting = {name: len(markers) for name, markers in _whole_animals().items() if {*markers} <= names}
    return max(fitting, key=lambda name: fitting[name], default=None)
