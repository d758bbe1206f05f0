"""The axis of errors: a mark lies where its number is, in a terminal and in a page."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from lxml import html

from ident.information.blocks import Error
from ident.show.card import Bar, Card
from ident.show.error_axis import BEFORE, NOISE, NOW, ErrorAxis
from ident.show.html import piece

DRAWN = 200  # errors before and now


@pytest.fixture(scope="module")
def cards():
    """Cards of five joints with errors from 1e-5 to 3 of the torque, some without a change."""
    random = np.random.default_rng(7)
    cards = []
    for _ in range(DRAWN // 5):
        bars = []
        for i in range(5):
            before, now, noise = map(float, 10 ** random.uniform((-5, -5, -5), (0.5, 0.5, -1)))
            after = Error(now, now, "N m") if i else None
            bars.append(Bar(f"j{i}", Error(before, before, "N m"), after, noise))
        cards.append(Card("", bars=tuple(bars)))
    return cards


def decade(axis: ErrorAxis, error: float) -> float:
    """Return the position of an error by the definition of a logarithmic axis."""
    return math.log10(error / axis.low) / math.log10(axis.high / axis.low)


def test_every_mark_lies_at_its_number_in_a_page(cards):
    for card in cards:
        rows = html.fromstring(str(piece("error_table", card))).findall(".//tbody/tr")
        for bar, row in zip(card.bars, rows, strict=True):
            before, now, noise = bar.sizes
            (dot,) = row.xpath('.//*[starts-with(@class, "now")]/@cx')
            assert float(dot[:-1]) == pytest.approx(100 * decade(card.axis, now), abs=1e-9)
            if bar.after:
                (ring,) = row.xpath('.//*[@class="before"]/@cx')
                assert float(ring[:-1]) == pytest.approx(100 * decade(card.axis, before), abs=1e-9)
            (floor,) = row.xpath('.//*[@class="noise"]/@x1')
            assert float(floor[:-1]) == pytest.approx(100 * decade(card.axis, noise), abs=1e-9)


def test_every_mark_lies_at_its_number_in_a_terminal(cards):
    """Within half a cell; of two marks in one cell the later one is seen."""
    for card in cards:
        lines = card.text()[-len(card.bars) :]
        for bar, line in zip(card.bars, lines, strict=True):
            strip = line[6:].split("  ")[0]
            cells, sizes = len(strip), bar.sizes
            at = [decade(card.axis, size) * (cells - 1) for size in sizes]
            assert abs(strip.index(NOW) - at[1]) <= 0.5
            for mark, place in ((BEFORE, at[0]), (NOISE, at[2])):
                if mark in strip:
                    assert abs(strip.index(mark) - place) <= 0.5
                elif mark == NOISE or bar.after:  # it is below another one
                    assert min(abs(place - at[1]), abs(place - at[0])) <= 1


def test_numbers_above_a_strip_stand_at_their_decades():
    for cells in (8, 20, 34):
        ruler = ErrorAxis().ruler(cells)
        for words in re.finditer(r"([\d.]+) %", ruler):
            middle = words.start() + len(words[0]) // 2
            place = decade(ErrorAxis(), float(words[1]) / 100) * (cells - 1)
            assert abs(middle - place) <= 3  # at an end it stands inside


def test_the_axis_is_the_same_unless_an_error_lies_outside():
    usual = ErrorAxis.of([0.002, 0.3, None, 0.0])
    assert (usual.low, usual.high) == (1e-3, 1.0)
    assert [words for _, words in usual.ticks] == ["0.1 %", "1 %", "10 %", "100 %"]
    longer = ErrorAxis.of([3e-5, 1.12])
    assert (longer.low, longer.high) == pytest.approx((2e-5, 2.0))
    tiny = ErrorAxis.of([1e-14, 0.5])
    assert len(tiny.ticks) <= 4
    assert (tiny.position(1e-14), tiny.position(0.0)) == (0.0, 0.0)
