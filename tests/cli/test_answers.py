"""Test what commands print on a terminal: lines, durations, and the time that is left."""

from __future__ import annotations

import io
import math
import re

import pytest

from recon.cli.answers import RemainingTime, duration_text, say, say_table, table_of, terminal


def test_remaining_time_is_right_within_a_factor_of_two():
    """The remaining time is right within a factor of two, although clips of 30 s finish two at a time."""
    now_s, shown = 0.0, {}
    remaining = RemainingTime(lambda: now_s)
    for tick in range(0, 121, 5):
        now_s = float(tick)
        ended, within = divmod(tick, 30)
        shown[tick] = remaining.text((2 * ended + 2 * 0.5 * min(1.0, within / 15)) / 8)
    assert shown[0] == shown[120] == ""
    assert shown[60] == "1 min left"
    for tick, text in shown.items():
        numbers = [int(x) for x in re.findall(r"\d+", text)]
        if numbers and tick < 110:
            left_s = 60 * numbers[0] + sum(numbers[1:]) if "min" in text else numbers[0]
            assert 0.5 <= left_s / (120 - tick) <= 2, (tick, text)


@pytest.mark.parametrize(("seconds", "text"), [(8, "8 s"), (130, "2 min 10 s"), (3900, "1 h 5 min"), (7200, "2 h")])
def test_durations_have_two_units_at_most(seconds, text):
    assert duration_text(seconds) == text


def test_lines_on_a_terminal_break_between_words():
    words = "Suspicious " * 12
    narrow = terminal(file=io.StringIO(), width=80, force_terminal=True)
    say(narrow, words)
    lines = narrow.file.getvalue().split("\n")
    assert {word for line in lines for word in line.split()} == {"Suspicious"}
    assert max(map(len, lines)) <= 80
    piped = terminal(file=io.StringIO(), width=80)
    say(piped, words)
    assert piped.file.getvalue() == words + "\n"


def test_a_table_in_a_pipe_is_not_wrapped():
    names = [f"column_{i:02}_with_a_long_name" for i in range(9)]
    pipe = terminal(file=io.StringIO(), width=80)
    say_table(pipe, table_of("method", numbers=names, rows=[["damped", *("123456789" for _ in names)]]))
    words = pipe.file.getvalue().split()
    assert ([word for word in words if "column" in word], words.count("123456789")) == (names, len(names))
    short = terminal(file=io.StringIO(), width=80)
    say_table(short, table_of("method", rows=[["damped"]]))
    assert max(map(len, short.file.getvalue().split("\n"))) <= 80


@pytest.mark.parametrize("width", [40, 80, 130])
def test_a_table_on_a_narrow_terminal_goes_on_below(width):
    """No word of a table is cut, and each of its parts begins with the names of the rows."""
    names = [f"column_{i}_of_nine" for i in range(9)]
    rows = [[method, *(f"{method}_{i}" for i in range(9))] for method in ("damped", "weighted")]
    narrow = terminal(file=io.StringIO(), width=width, force_terminal=True)
    say_table(narrow, table_of("method", numbers=names, rows=rows, title="closure"))
    text = re.sub(r"\x1b\[[0-9;]*m", "", narrow.file.getvalue())
    assert max(map(len, text.split("\n"))) <= width
    words = text.split()
    assert words.count("closure") == 1
    assert [word for word in words if word in names] == names
    assert [word for word in words if word.startswith("weighted_")] == rows[1][1:]
    assert words.count("weighted") == words.count("method") == math.ceil(9 / ((width - 12) // 19))


def test_a_column_of_single_words_is_not_cut_before_others_wrap():
    narrow = terminal(file=io.StringIO(), width=60, force_terminal=True)
    row = ["extended-differences", "1.0", "27", "front_trunk_roll", "12"]
    say_table(narrow, table_of("method", numbers=("worst error mm", "off °", "limits", "each"), rows=[row]))
    assert {*row} <= {*narrow.file.getvalue().split()}


@pytest.mark.parametrize("is_terminal", [True, False])
def test_words_of_text_columns_are_not_lost(is_terminal):
    """Short words stay whole everywhere; a long path is broken on a narrow terminal only."""
    path = "results/a_long_folder/with_a_longer_name/of_a_clip"
    console = terminal(file=io.StringIO(), width=60, force_terminal=is_terminal)
    rows = [["rear_trunk", "", path, "0.000"], ["front_trunk_segment", "rear_trunk", "done", "-46 to 46"]]
    say_table(console, table_of("segment", "parent", "folder", numbers=("angle",), rows=rows))
    words = console.file.getvalue().split()
    assert {"front_trunk_segment", "rear_trunk", "0.000", "done"} <= {*words}
    assert path in (words if not is_terminal else "".join(word for word in words if word in path))
