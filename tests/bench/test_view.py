"""The recording holds what it promises, the viewer stays on loopback and leaves nothing behind."""

import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import psutil
import pytest
from scipy.spatial.transform import Rotation

from bench.drawing import Flight, airframe_mesh, drawn_scene, edge_columns, quaternion_z_up, rotation_matrices, z_up
from bench.plots import plot_top_view
from bench.rerun_log import record_flight
from bench.view import Viewer, flight_picture, open_run, recordings_of, screenshot
from saranga.echo import HISTORY_ROWS
from saranga.errors import BenchError, DeviceError, UsageError
from tests.bench.fabricated_flight import POLES, fabricated_log, fabricated_result

EVERY_TICK = ("/world/airframe", "/world/trail", "/world/detections", "/sonar_left/image", "/sonar_right/image",
              "/sonar_left/image/edges", "/sonar_right/image/edges", "/velocity/forward/commanded",
              "/velocity/right/commanded", "/velocity/down/commanded", "/velocity/forward/flown",
              "/velocity/right/flown", "/velocity/down/flown", "/distance/nearest_obstacle")
ONCE = ("/world", "/world/arena/floor", "/world/arena/outline", "/world/arena/net", "/world/start",
        "/world/goal_line", "/world/path", "/world/airframe/body", "/world/airframe/sonar_reach", "/verdict",
        *(f"/world/obstacles/cylinder_{k + 1}" for k in range(len(POLES))))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_flight(fabricated_log(), fabricated_result(), tmp_path_factory.mktemp("rrd") / "flight-7.rrd")


def chunks_of(path: Path) -> dict[str, list]:
    from rerun.chunk import RrdReader

    found = defaultdict(list)
    for chunk in RrdReader(str(path)).stream():
        found[chunk.entity_path].append(chunk)
    return found


def timed_column(chunks: list, component: str) -> list:
    """Values of one component over time, in the order of the timeline."""
    rows = []
    for chunk in chunks:
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            time_s = batch.column("sim_time").to_pylist()
            rows += zip(time_s, batch.column(component).to_pylist(), strict=True)
    return [value for _, value in sorted(rows, key=lambda row: row[0])]


def test_every_promised_entity_is_there_with_a_row_a_tick(recorded: Path) -> None:
    log = fabricated_log()
    chunks = chunks_of(recorded)
    for entity in EVERY_TICK:
        assert sum(c.num_rows for c in chunks[entity] if not c.is_static) == len(log.t_us), entity
        assert all(c.timeline_names == ["sim_time"] for c in chunks[entity] if not c.is_static), entity
    for entity in ONCE:
        assert sum(c.num_rows for c in chunks[entity] if c.is_static) >= 1, entity
    assert sum(c.num_rows for c in chunks["/events"]) == len(log.events) + 1  # and the verdict
    text = chunks["/verdict"][0].to_record_batch().column("TextDocument:text").to_pylist()[0][0]
    assert "PASS: clean flight" in text and "goal reached and landed" in text and "seed 7" in text


def test_recorded_values_are_the_logs_in_a_z_up_world(recorded: Path) -> None:
    log = fabricated_log()
    chunks = chunks_of(recorded)
    shown = np.array(timed_column(chunks["/world/airframe"], "Transform3D:translation")).reshape(-1, 3)
    assert np.allclose(shown, np.stack([log.pos_m[:, 0], -log.pos_m[:, 1], -log.pos_m[:, 2]], axis=1), atol=1e-5)
    assert shown[100, 2] > 0.9  # flies above the floor, not below
    forward = np.array(timed_column(chunks["/velocity/forward/commanded"], "Scalars:scalars")).reshape(-1)
    course = np.array(log.phase) == "course"
    assert np.allclose(forward[course], log.command[course, 0])
    assert np.isnan(forward[~course]).all()  # decided but not sent
    pole = chunks["/world/obstacles/cylinder_3"][0].to_record_batch().column("Mesh3D:vertex_positions").to_pylist()[0]
    centre = np.array(pole).mean(axis=0)
    assert centre[:2] == pytest.approx((POLES[2][0], -POLES[2][1]), abs=0.01)  # right of the course is y < 0 here


def test_newest_echo_row_is_the_last_row_of_the_picture(recorded: Path) -> None:
    log = fabricated_log()
    pictures = timed_column(chunks_of(recorded)["/sonar_left/image"], "DepthImage:buffer")
    tick = 120
    shown = np.array(pictures[tick][0], dtype=np.uint8).reshape(HISTORY_ROWS, -1)
    assert (shown[-1] == np.maximum(log.envelope_left[tick], 1)).all()  # 0 would be "no depth"
    assert (shown[0] == np.maximum(log.envelope_left[tick - HISTORY_ROWS + 1], 1)).all()
    first = np.array(pictures[0][0], dtype=np.uint8).reshape(HISTORY_ROWS, -1)
    assert (first[:-1] == 1).all() and (first[-1] == np.maximum(log.envelope_left[0], 1)).all()


def test_detections_lie_on_the_poles(recorded: Path) -> None:
    points = [p for tick in timed_column(chunks_of(recorded)["/world/detections"], "Points3D:positions")
              for p in tick or []]
    assert len(points) > 50
    poles = np.array([(x, -y) for x, y in POLES])
    nearest = [np.min(np.hypot(*(poles - np.array(p[:2])).T)) for p in points]
    assert np.median(nearest) < 0.05


def test_a_recording_of_20_s_is_small(tmp_path: Path) -> None:
    log, result = fabricated_log(), fabricated_result()
    path = record_flight(log, result, tmp_path / "f.rrd")
    assert path.stat().st_size * 320 / len(log.t_us) < 20e6


def test_a_recording_that_fails_leaves_no_file(tmp_path: Path) -> None:
    log = fabricated_log()
    del log.scene["course"]
    with pytest.raises(BenchError, match="cannot be drawn"):
        record_flight(log, fabricated_result(), tmp_path / "f.rrd")
    with pytest.raises(BenchError, match="empty"):
        empty = fabricated_log()
        empty.t_us = empty.t_us[:0]
        record_flight(empty, fabricated_result(), tmp_path / "f.rrd")
    assert list(tmp_path.iterdir()) == []


def test_frames_turn_consistently() -> None:
    quat = np.random.default_rng(3).normal(size=(20, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    assert np.allclose(rotation_matrices(quat), Rotation.from_quat(quat, scalar_first=True).as_matrix())
    body = np.array([0.3, -0.2, 0.5])
    shown = Rotation.from_quat(quaternion_z_up(quat)).apply(z_up(body))
    assert np.allclose(shown, z_up(rotation_matrices(quat) @ body))


def test_scene_distance_is_to_the_surface() -> None:
    scene = drawn_scene(fabricated_log().scene)
    x, y = POLES[0]
    assert scene.distance_m(np.array([(x - 1.0, y, -1.0)])) == pytest.approx(1.0 - 0.03, abs=1e-9)
    hull = scene.obstacles[0].footprint_m(0, 1)
    assert np.hypot(*(hull - (x, y)).T) == pytest.approx(0.03, abs=1e-6)


def test_edge_columns_gives_one_column_a_run() -> None:
    row = np.zeros(64, dtype=np.uint8)
    row[10:13] = (140, 250, 150)
    row[40] = 130
    row[50] = 127
    assert edge_columns(row).tolist() == [11, 40]


def test_airframe_spans_its_wheelbase_and_propellers() -> None:
    vertices, triangles, colours = airframe_mesh({"wheelbase_m": 0.16, "prop_diameter_m": 0.0762})
    assert np.abs(vertices[:, 0]).max() == pytest.approx(0.08 * np.sqrt(0.5) + 0.0381, abs=1e-3)
    assert triangles.max() == len(vertices) - 1 and len(colours) == len(vertices)


def test_telling_moment_has_an_obstacle_near() -> None:
    flight = Flight(fabricated_log(), fabricated_result())
    tick = int(np.argmin(np.abs(flight.time_s - flight.telling_time_s())))
    course = [k for k, phase in enumerate(flight.log.phase) if phase == "course"]
    assert course[0] + 0.4 * len(course) <= tick <= course[0] + 0.6 * len(course)
    assert flight.log.obstacles[tick]
    assert flight.centre_distance_m[tick] < np.median(flight.centre_distance_m[course])


def test_top_view_file_is_repeatable_and_refuses_other_kinds(tmp_path: Path) -> None:
    log, result = fabricated_log(hit=True), fabricated_result(hit=True)
    one, two = (plot_top_view(log, result, tmp_path / name).read_bytes() for name in ("a.png", "b.png"))
    assert one == two and one[:8] == b"\x89PNG\r\n\x1a\n"
    assert int.from_bytes(one[16:20], "big") == 1600
    with pytest.raises(UsageError, match=r"\.png or \.svg"):
        plot_top_view(log, result, tmp_path / "a.jpg")


# ---- the viewer as a process -------------------------------------------------------------------------


def group_members(group: int) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter():
        try:
            if os.getpgid(process.pid) == group and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
        except (ProcessLookupError, psutil.Error):
            continue
    return found


def listeners(group: int) -> list[str]:
    return [c.laddr.ip for p in group_members(group) for c in p.net_connections() if c.status == psutil.CONN_LISTEN]


@pytest.mark.wall_time
def test_viewer_listens_on_loopback_only_and_leaves_nothing(recorded: Path, tmp_path: Path,
                                                            monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    with Viewer([recorded], web=True) as viewer:
        group = viewer.pid
        found = listeners(group)
        assert len(found) == 2 and set(found) == {"127.0.0.1"}
        time.sleep(0.5)
        assert "Welcome to Rerun" not in viewer.log_text()  # that greeting is the analytics opt-out notice
    assert group_members(group) == []
    assert list(tmp_path.iterdir()) == []  # the user's settings were not touched


@pytest.mark.wall_time
@pytest.mark.skipif(sys.platform != "linux", reason="the parent-death signal is Linux's")
def test_viewer_dies_with_a_killed_parent(recorded: Path, tmp_path: Path) -> None:
    code = ("import sys, time; from pathlib import Path; from bench.view import Viewer\n"
            f"v = Viewer([Path({str(recorded)!r})], web=True); print(v.pid, flush=True); time.sleep(60)")
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True,
                              env=dict(os.environ, TMPDIR=str(tmp_path)))  # a killed parent cannot tidy up
    try:
        assert parent.stdout is not None
        group = int(parent.stdout.readline())
        assert group_members(group)
    finally:
        parent.send_signal(signal.SIGKILL)
        parent.communicate()
    deadline = time.monotonic() + 5.0
    while group_members(group) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert group_members(group) == []


@pytest.mark.wall_time
def test_picture_of_a_recording_with_any_text_in_it(tmp_path: Path) -> None:
    from matplotlib.image import imread

    # the viewer dies of a character its font lacks, so a recording must not hold one whatever a user writes
    log, result = fabricated_log(), fabricated_result()
    every = "".join(map(chr, [*range(9, 14), *range(32, 0x180), 0x2013, 0x2716, 0x2718, 0x4E2D, 0x1F680]))
    result.scene, result.cause, result.part = f"my/{every}.toml", f"goal reached {every}", every
    log.events.append((int(log.t_us[50]), every))
    any_text = record_flight(log, result, tmp_path / "flight-1.rrd")
    try:
        png = screenshot(any_text, tmp_path / "f.png", time_s=11.0)
    except DeviceError as error:
        if "mesa-vulkan-drivers" in str(error):
            pytest.skip(str(error))
        raise
    picture = (imread(png)[:, :, :3] * 255).astype(int)
    assert picture.shape == (900, 1600, 3)
    course, echoes = picture[70:610, 10:1190], picture[650:840, 20:580]
    blue = (course[..., 2] > 200) & (course[..., 0] < 100)  # the flown path and the sonar's reach
    orange = (course[..., 0] > 150) & (course[..., 2] < 90)  # the poles
    assert blue.sum() > 800 and orange.sum() > 1500
    assert (echoes.sum(axis=2) > 400).mean() > 0.006  # bright echo streaks


@pytest.mark.wall_time
def test_no_graphics_driver_is_named_with_the_remedy(recorded: Path, tmp_path: Path,
                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(name, "/nonexistent")
    monkeypatch.setenv("WGPU_BACKEND", "vulkan")
    with pytest.raises(DeviceError, match="apt-get install mesa-vulkan-drivers"):
        screenshot(recorded, tmp_path / "f.png")
    assert list(tmp_path.iterdir()) == []
    drawn, note = flight_picture(fabricated_log(), fabricated_result(), tmp_path / "f.png")
    assert drawn.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert "from above" in note and "mesa-vulkan-drivers" in note


def test_bad_paths_are_named(tmp_path: Path, recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        screenshot(tmp_path / "none.rrd", tmp_path / "f.png")
    with pytest.raises(UsageError, match=r"no \.rrd recording"):
        open_run(tmp_path)
    assert recordings_of(recorded.parent) == [recorded]
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    if sys.platform == "linux":
        with pytest.raises(DeviceError, match="no display"):
            open_run(recorded)
