"""The rows of README and bench/README: figures that are printed, filled in, and put into pages."""

from __future__ import annotations

import math

import pytest

from bench.support import figures
from bench.support.figures import Row, line_of


def test_printed_figures_fill_a_template() -> None:
    lines = ["a table", line_of("pipe: time, here / base", 0.25), line_of("F1", 0.9, 0.031)]
    printed = figures.read_lines(lines)
    assert figures.filled("{F1:.2f}; {pipe: time, here / base:.1f} s", printed) == (
        "0.90 (0.03); 0.2 s"
    )
    assert figures.filled("{F1:+.2f}", printed) == "+0.90 (0.03)"
    assert printed["F1"].value == 0.9
    assert math.isnan(printed["pipe: time, here / base"].error)
    with pytest.raises(KeyError, match="recall"):
        figures.filled("{recall:.2f}", printed)


def test_a_table_is_put_between_its_marks_only() -> None:
    row = Row("Faults", "events lost", "0", "python -m bench x", "1234567", "2026-01-01")
    page = "before\n<!-- figures: Faults -->\nold\n<!-- end -->\nafter\n<!-- end -->\n"
    text = figures.with_tables(page, figures.tables([row]))
    assert text.startswith("before\n<!-- figures: Faults -->\n\n| what")
    assert "| events lost | 0 | `python -m bench x` | none | - | 1234567 |\n" in text
    assert text.endswith("\n<!-- end -->\nafter\n<!-- end -->\n")
    assert "old" not in text
    assert figures.with_tables(text, figures.tables([row])) == text


def test_what_mechanisms_are_worth_is_a_table_with_its_command_below() -> None:
    [section, *_] = figures.MECHANISMS
    command = "python -m bench ablation --data FOLDER"
    row = Row(section, "speed", "+0.010 (0.004); 0.00; 0", command, "1234567", "2026-01-01", "real")
    lines = figures.tables([row])[section].splitlines()
    assert lines[0] == "| without | log loss | links | false links |"
    assert lines[2] == "| speed | +0.010 (0.004) | 0.00 | 0 |"
    assert lines[4] == f"`{command}`, the recordings with identities, - minutes, commit 1234567."


def test_rows_are_of_known_sections_and_data_and_readme_has_a_row_for_all() -> None:
    rows = figures.read()
    assert {row.section for row in rows} <= {*figures.SECTIONS, *figures.MECHANISMS}
    assert all(row.data in figures.DATA for row in rows)
    assert all(
        row.quick or "campaign" in row.command for row in rows if row.readme and not row.data
    )
