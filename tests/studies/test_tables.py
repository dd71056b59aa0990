import numpy as np
import pytest
from rich.console import Console

from jaxtrack.studies import tables
from jaxtrack.studies.tables import Figure, Mark, Row


def printed(table):
    console = Console(width=160, record=True, file=None, quiet=False)
    with console.capture() as capture:
        console.print(table)
    return capture.get()


@pytest.mark.parametrize(
    ("figure", "mark", "verdict"),
    [
        (Figure(0.90, 0.85, 0.94, 200), Mark(0.93), "pass"),  # the interval reaches the mark
        (Figure(0.90, 0.85, 0.92, 200), Mark(0.93), "fails"),
        (Figure(0.99, 0.97, 1.00, 200), Mark(0.93), "pass"),
        (Figure(0.20, 0.14, 0.27, 200), Mark(0.15, at_least=False), "pass"),
        (Figure(0.20, 0.16, 0.27, 200), Mark(0.15, at_least=False), "fails"),
        (Figure(0.00, 0.00, 0.17, 19), Mark(0.93), "smoke"),
        (Figure(0.00, 0.00, 0.16, 20), Mark(0.93), "fails"),
        (Figure(np.nan, np.nan, np.nan, 200), Mark(0.93), "fails"),
        (Figure(np.nan, np.nan, np.nan, 200), Mark(0.93, at_least=False), "fails"),
        (Figure(0.90, 0.85, 0.94, 200), None, ""),
    ],
)
def test_verdicts(figure, mark, verdict):
    assert tables.verdict(figure, mark) == verdict


def test_a_table_of_few_trials_says_smoke_and_gives_no_verdict():
    rows = [
        Row("joint", tables.rate(19, 19), "good", Mark(0.5)),
        Row("HT", tables.rate(0, 19), "poor", Mark(0.5)),
    ]
    text = printed(tables.marks_table("Marks", rows))
    assert text.count("smoke") == 2
    assert "pass" not in text
    assert "fails" not in text


def test_a_table_of_marks_shows_ours_the_papers_words_and_the_verdict():
    rows = [
        Row("joint", tables.rate(197, 200), "good", Mark(0.97)),
        Row("HT", tables.rate(2, 200), "poor", Mark(0.97)),
        Row("IHT", tables.rate(2, 200), "serious"),
    ]
    text = printed(tables.marks_table("", rows))
    joint, ht, iht = (line for line in text.splitlines() if "200" in line)
    assert all(word in joint for word in (".985", "≥ 0.97", "good", "pass"))
    assert "fails" in ht
    assert "serious" in iht
    assert "≥" not in iht


def test_the_root_mean_square_error_and_its_interval_follow_the_ratio():
    rng = np.random.default_rng(0)
    counts = rng.integers(0, 4, 4000)
    squares = np.array([(rng.normal(0.0, 7.0, n) ** 2).sum() for n in counts])
    figure = tables.root_mean_square(squares, counts, 4000, "m")
    assert figure.value == pytest.approx(np.sqrt(squares.sum() / counts.sum()))
    assert figure.lower < 7.0 < figure.upper
    assert figure.upper - figure.lower < 0.4
    assert np.isnan(tables.root_mean_square(np.zeros(3), np.zeros(3), 3).value)


def test_rates_and_means_carry_95_percent():
    assert tables.rate(0, 50).lower == 0.0
    assert tables.rate(50, 50).upper == 1.0
    assert tables.rate(90, 100)[1:3] == pytest.approx((0.8256, 0.9448), abs=1e-4)
    assert tables.mean(2.5, 0.1, 30)[1:3] == pytest.approx((2.304, 2.696), abs=1e-3)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0, "", ".000"),
        (0.9996, "", "1.000"),
        (1.0, "", "1"),
        (-0.25, "", "-.250"),
        (12.34, "m", "12.3 m"),
        (4020.9, "", "4021"),
        (0.00451, "rad", "0.0045 rad"),
        (np.nan, "m", "–"),
    ],
)
def test_numbers(value, unit, text):
    assert tables.number(value, unit) == text


def test_what_fails_is_listed_whatever_else_is_smoke():
    rows = [
        Row("bad", tables.rate(10, 1000), "", Mark(0.98)),
        Row("few", tables.rate(3, 4), "", Mark(0.98)),
        Row("good", tables.rate(1000, 1000), "", Mark(0.98)),
        Row("shown", tables.rate(1, 1000), "", None),
    ]
    table = tables.failed_table("Marks", rows)
    assert not isinstance(table, str)
    assert table.row_count == 1
    assert not isinstance(table, str)
    assert str(table.title).startswith("Marks: 1 of 3 pass, 1 smoke")
    # Without a row there is no table, but the count.
    assert tables.failed_table("Marks", rows[2:]) == "Marks: 1 of 1 pass."


def test_rows_become_entries_of_a_summary():
    entry = tables.entry(Row("joint", tables.rate(40, 40), "good", Mark(0.97)))
    assert entry["verdict"] == "pass"
    assert entry[">="] == 0.97
    assert entry["trials"] == 40
    assert "<=" in tables.entry(Row("", tables.rate(1, 40), "", Mark(0.1, at_least=False)))


def test_columns_that_do_not_fit_stand_beneath_and_nothing_is_cut():
    heads = ["method", "sigma_m", "error_m", "beyond", "error_m - mean"]
    rows = [["mean", "1.0", "1.25 ± .03", ".312 ± .008", ""],
            ["joint", "1.0", "1.15 ± .03", ".212 ± .008", "-.10 ± .01"]]  # fmt: skip
    for width in (31, 40, 60, None):
        found = tables.beneath(heads, rows, fields=2, width=width)
        console = Console(width=width or 200)
        with console.capture() as capture:
            for table in found:
                console.print(table)
        text = capture.get()
        assert {31: 3, 40: 2, 60: 1, None: 1}[width] == len(found)
        assert all(cell in text for line in (heads, *rows) for cell in line)
        assert [len(table.rows) for table in found] == {1: [2], 2: [2, 1], 3: [2, 2, 1]}[len(found)]
    narrow = printed_at(12, tables.beneath(heads, rows, fields=2, width=12)[0])
    assert "…" not in narrow
    grid = tables.grid_table("", ["joint"], ["a_long_word_without_an_end"], [["1.25"]], trials=30)
    assert "…" not in printed_at(20, grid)


def printed_at(width, table):
    console = Console(width=width)
    with console.capture() as capture:
        console.print(table)
    return capture.get()
