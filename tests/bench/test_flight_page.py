"""The page of a run says what happened, stands alone, and survives what a run can look like."""

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.drawing import Flight
from bench.flight_page import MAX_DRAWN, write_page
from bench.flight_summary import replay_command
from bench.flight_svg import echo_strip, side_view, top_view
from bench.journal import open_journal
from saranga.errors import UsageError
from tests.bench.fabricated_flight import POLES, fabricated_log, fabricated_result

REQUEST: dict[str, Any] = {"scene": "fabricated", "seed": 7, "autopilot": "embedded", "stack": "saranga",
                           "denoiser": "tbd", "shield": "foam", "sonar": "pair", "faults": {}, "max_sim_s": 180.0}
VOID = {"meta", "br", "link", "img", "hr", "line", "circle", "path", "polyline", "rect", "image", "input"}


class Reader(HTMLParser):
    """Visible text, and whether every element is closed in order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.words: list[str] = []
        self.tags: list[str] = []
        self.badly_closed: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID and (not self.open or self.open.pop() != tag):
            self.badly_closed.append(tag)

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


def make_run(folder: Path, hits: list[bool], planned: int | None = None, finished: bool = True,
             cause: str | None = None, logs: bool = True) -> Path:
    """A run folder as `bench.fly` leaves it, from fabricated flights."""
    seeds = list(range(7, 7 + (planned or len(hits))))
    saved: dict[bool, bytes] = {}
    with open_journal(folder / "journal.jsonl", run_kind="fly", run=str(folder), request=REQUEST, seeds=seeds,
                      limits=[], versions={"python": "3.11"}, git={"commit": "c0ffee", "dirty": False},
                      sha256={"scene": "5" * 64}) as journal:
        for seed, hit in zip(seeds, hits, strict=False):
            result = fabricated_result(hit)
            result.seed = seed
            if cause is not None:
                result.cause = cause
            journal.append("trial", seed=seed, request=REQUEST | {"seed": seed}, result=result.to_dict())
            if logs:
                if hit not in saved:
                    saved[hit] = fabricated_log(hit).save(folder / "one.npz").read_bytes()
                (folder / f"flight-{seed}.npz").write_bytes(saved[hit])
                journal.append("files", seed=seed, files={"log": f"flight-{seed}.npz"})
        if finished:
            journal.append("end", state="finished")
    return folder


def page_of(folder: Path) -> str:
    return write_page(folder).read_text(encoding="utf-8")


def test_one_clean_flight(tmp_path: Path) -> None:
    page = page_of(make_run(tmp_path, [False]))
    read = Reader(page)
    assert read.badly_closed == [] and read.open == []
    assert "PASS" in read.text and "goal reached and landed" in read.text
    assert replay_command(REQUEST, 7) in read.text and "--seed 7" in read.text
    assert "simulated flight, simulated autopilot" in read.text and "measured" in read.text
    assert "c0ffee" in read.text and "0.31 m" in read.text


def test_page_needs_nothing_from_outside(tmp_path: Path) -> None:
    page = page_of(make_run(tmp_path, [True, False]))
    assert not re.search(r"https?:|//[a-z]", re.sub(r"base64,[A-Za-z0-9+/=]+", "", page))
    tags = set(Reader(page).tags)
    assert not tags & {"script", "link", "iframe", "img"}
    assert all(value.startswith(("data:image/png;base64,", "#")) for value in re.findall(r'href="([^"]*)"', page))


def test_failure_comes_first_with_cause_and_part(tmp_path: Path) -> None:
    page = page_of(make_run(tmp_path, [False, True, False]))
    text = Reader(page).text
    assert text.index("FAIL") < text.index("First failure, seed 8: propeller touched cylinder 4")
    drawings = re.findall(r'<details id="([^"]+)"', page)
    assert drawings == ["flight-2", "flight-1", "flight-3"]
    assert "hit an obstacle, propeller" in text


def test_hostile_text_is_text(tmp_path: Path) -> None:
    page = page_of(make_run(tmp_path, [True], cause="<script>alert(1)</script> & 'so on'"))
    read = Reader(page)
    assert "script" not in read.tags and read.badly_closed == []
    assert "<script>alert(1)</script> & 'so on'" in read.text


def test_a_run_cut_short_says_so(tmp_path: Path) -> None:
    text = Reader(page_of(make_run(tmp_path, [False, False], planned=5, finished=False))).text
    assert "INCONCLUSIVE" in text and "Cut short after 2 of 5." in text


def test_no_flight_at_all(tmp_path: Path) -> None:
    text = Reader(page_of(make_run(tmp_path, [], planned=1, finished=False))).text
    assert "no flight was finished" in text and "PASS" not in text


def test_missing_and_damaged_logs_are_named(tmp_path: Path) -> None:
    folder = make_run(tmp_path, [False, False])
    (folder / "flight-7.npz").unlink()
    damaged = folder / "flight-8.npz"
    damaged.write_bytes(damaged.read_bytes()[:2000])
    text = Reader(page_of(folder)).text
    assert "flight-7.npz does not exist" in text and "not a readable flight log" in text
    (tmp_path / "other").mkdir()
    assert "no flight log was kept" in Reader(page_of(make_run(tmp_path / "other", [False], logs=False))).text


def test_many_flights_are_listed_but_not_all_drawn(tmp_path: Path) -> None:
    count = MAX_DRAWN + 3
    page = page_of(make_run(tmp_path, [False] * (count - 1) + [True]))
    assert page.count("<details") == MAX_DRAWN and "3 more flights are in the table" in page
    assert f'<details id="flight-{count}" open' in page  # the failure, flown last
    assert page.count("--seed") == count
    assert len(page) < 6e6


def test_a_run_of_tests_shows_the_tests(tmp_path: Path) -> None:
    result = fabricated_result(hit=True)
    with open_journal(tmp_path / "journal.jsonl", run_kind="test", run="x", versions={}, git={}) as journal:
        journal.append("trial", seed=7, request=REQUEST, result=result.to_dict())
        journal.append("test", test="test_a.py::test_hit", outcome="failed", text="NotAccepted: FAIL: flights")
        journal.append("test", test="test_a.py::test_more", outcome="passed", text="")
        journal.append("end", state="finished")
    text = Reader(page_of(tmp_path)).text
    assert "1 test failed, 1 test passed. First failure, test_a.py::test_hit: NotAccepted: FAIL" in text
    assert "test_a.py::test_more" in text and "propeller touched cylinder 4" in text


def test_no_journal_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        write_page(tmp_path)
    assert list(tmp_path.iterdir()) == []


def numbers(svg: str, pattern: str) -> list[np.ndarray]:
    return [np.array([[float(v) for v in pair.split(",")] for pair in points.split()])
            for points in re.findall(pattern, svg)]


def test_views_are_to_scale() -> None:
    flight = Flight(fabricated_log(), fabricated_result())
    view = top_view(flight)
    poles = numbers(view, r'<polygon points="([^"]+)"')
    centres = np.array([p.mean(axis=0) for p in poles])
    scale = (centres[3, 0] - centres[0, 0]) / (POLES[3][0] - POLES[0][0])
    expected = np.array(POLES) * scale
    assert np.allclose(centres - centres[0], expected - expected[0], atol=0.3)  # y to the right is down the page
    assert np.ptp(poles[0][:, 0]) == pytest.approx(0.06 * scale, abs=0.3)
    path = numbers(view, r'<polyline points="([^"]+)"')[0]
    log = flight.log
    assert (path[-1] - path[0]) / scale == pytest.approx((log.pos_m[-1] - log.pos_m[0])[:2], abs=0.01)
    side = numbers(side_view(flight), r'<polyline points="([^"]+)"')[0]
    climbed = (side[0, 1] - side[:, 1].min()) / scale
    assert climbed == pytest.approx(np.ptp(log.pos_m[:, 2]), abs=0.02)  # up is up


def test_echo_strip_marks_edges_at_their_range() -> None:
    log = fabricated_log(hit=True)
    flight = Flight(log, fabricated_result(hit=True))
    svg = echo_strip(flight)
    assert svg.count("<image") == 2 and svg.count("data:image/png;base64,") == 2
    marks = re.findall(r'<path d="([^"]*)" stroke="#50ffdc"', svg)
    ends = [float(m.split()[1]) for m in re.findall(r"M[\d.]+ [\d.]+", marks[0])]
    assert max(ends) > 150  # closing in: the last edges sit low in the left strip, which spans 18 to 188
    log.envelope_left = log.envelope_right = np.zeros((len(log.t_us), 0), dtype=np.uint8)
    assert echo_strip(Flight(log, fabricated_result(hit=True))) == ""
