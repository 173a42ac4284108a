"""A flight as a Rerun recording (.rrd): written after the flight, a column an entity, so it costs the flight nothing.

Entities: /world (arena, obstacles, start, goal_line, path, trail, airframe with its sonar fan, detections, outcome),
/sonar_left and /sonar_right (rolling echo image, its edges and range ticks), /velocity (commanded against flown),
/distance, /verdict, /events. Timeline `sim_time`, simulated seconds. The world is drawn z up (`drawing.z_up`).
"""

from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from bench.blueprint import TIMELINE, flight_blueprint
from bench.drawing import (
    DETECTION_COLOUR,
    GOAL_COLOUR,
    OUTCOME_WORDS,
    PATH_COLOUR,
    SONAR_ORIGIN_M,
    Flight,
    airframe_mesh,
    echo_shades,
    edge_columns,
    heading_velocity_m_s,
    kind_colour,
    outcome_colour,
    quaternion_z_up,
    rgb,
    sent_commands,
    z_up,
)
from bench.verdict_text import flight_markdown, viewer_text
from saranga.echo import COLUMN_M, HISTORY_ROWS, RANGE_COLUMNS
from saranga.errors import BenchError
from sitl.trial_types import FlightLog, TrialResult

ROW_STRETCH = 5.0
"""An image is 16 times as wide as high; each row is drawn this many columns high."""
_FAN_HALF_ANGLE_RAD = np.radians(70.0)  # the horn's -3 dB half-width across, fixtures/sonars
_EDGE_COLOUR = (80, 255, 220)


def record_flight(log: FlightLog, result: TrialResult, path: Path) -> Path:
    """Write the recording of a flight; whole or not at all.

    Raises:
        BenchError: a log without ticks or with a scene that cannot be drawn.
    """
    if len(log.t_us) == 0:
        raise BenchError(f"{result.scene} seed {result.seed}: the flight log is empty, nothing to record")
    flight = Flight(log, result)
    width, height = float(RANGE_COLUMNS), HISTORY_ROWS * ROW_STRETCH
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    recording = rr.RecordingStream("saranga-bench", recording_id=viewer_text(
        f"{result.scene}-{result.seed}-{result.determinism_hash[:12]}"), send_properties=False)
    recording.save(part, default_blueprint=flight_blueprint(flight.scene, width, height + 22.0))
    try:
        recording.send_recording_name(viewer_text(f"{result.scene} seed {result.seed}: {result.outcome}"))
        writer = _Writer(recording, flight)
        writer.scene()
        writer.airframe()
        writer.path()
        writer.detections()
        for side, rows, edges in (("left", log.envelope_left, log.edges_left),
                                  ("right", log.envelope_right, log.edges_right)):
            writer.sonar(side, rows, edges)
        writer.plots()
        writer.texts()
        recording.flush()
    except BaseException:
        recording.disconnect()
        part.unlink(missing_ok=True)
        raise
    recording.disconnect()
    return part.replace(path)


class _Writer:
    """One flight into one recording, entity by entity."""

    def __init__(self, recording: rr.RecordingStream, flight: Flight) -> None:
        self.recording = recording
        self.flight = flight
        self.times = [rr.TimeColumn(TIMELINE, duration=flight.time_s)]

    def fixed(self, entity: str, *what: rr.AsComponents) -> None:
        self.recording.log(entity, *what, static=True)

    def columns(self, entity: str, columns: rr.ComponentColumnList, times: list[rr.TimeColumn] | None = None
                ) -> None:
        rr.send_columns(entity, times or self.times, columns, recording=self.recording)

    def scene(self) -> None:
        scene = self.flight.scene
        (x0, x1), (y0, y1), top = scene.x_m, scene.y_m, scene.height_m
        self.fixed("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        floor = np.array([(x0, -y0, 0), (x1, -y0, 0), (x1, -y1, 0), (x0, -y1, 0)])
        up, lifted = np.array([0.0, 0.0, top]), np.array([0.0, 0.0, 0.01])
        self.fixed("world/arena/floor", rr.Mesh3D(vertex_positions=floor - lifted,
                                                  triangle_indices=[[0, 1, 2], [0, 2, 3]],
                                                  albedo_factor=[34, 40, 52]))
        metre_lines = [[(x, -y0, 0), (x, -y1, 0)] for x in np.arange(np.ceil(x0), x1 + 1e-6)]
        metre_lines += [[(x0, -y, 0), (x1, -y, 0)] for y in np.arange(np.ceil(y0), y1 + 1e-6)]
        self.fixed("world/arena/metre_grid", rr.LineStrips3D(metre_lines, colors=[62, 72, 90], radii=-0.5))
        ring = [*floor, floor[0]]
        posts = [[corner, corner + up] for corner in floor]
        self.fixed("world/arena/outline", rr.LineStrips3D([ring], colors=[120, 150, 190], radii=-0.8))
        if scene.netted:
            self.fixed("world/arena/net", rr.LineStrips3D([[p + up for p in ring], *posts],
                                                          colors=[58, 72, 94], radii=-0.5))
        for obstacle in scene.obstacles:
            points, faces = z_up(obstacle.vertices_m), obstacle.triangles
            flat = points[faces].reshape(-1, 3)  # own corners for every face, so that edges stay sharp
            self.fixed(f"world/obstacles/{obstacle.name}",
                       rr.Mesh3D(vertex_positions=flat, vertex_normals=_face_normals(flat),
                                 triangle_indices=np.arange(len(flat)).reshape(-1, 3),
                                 albedo_factor=rgb(kind_colour(obstacle.kind))))
        start = z_up(np.array([scene.start_m[0], scene.start_m[1], 0.0]))
        self.fixed("world/start", rr.LineStrips3D([_circle(start + lifted, 0.25)],
                                                  colors=[235, 240, 250], radii=-1.5, labels=["start"]))
        goal = np.array([(scene.goal_x_m, -y0, 0), (scene.goal_x_m, -y1, 0),
                         (scene.goal_x_m, -y1, 0.35), (scene.goal_x_m, -y0, 0.35)])
        self.fixed("world/goal_line", rr.LineStrips3D([goal[:2] + lifted], colors=rgb(GOAL_COLOUR),
                                                      radii=-2.5, labels=["goal"]))
        self.fixed("world/goal_line/ribbon", rr.Mesh3D(vertex_positions=goal,
                                                       triangle_indices=[[0, 1, 2], [0, 2, 3]],
                                                       albedo_factor=[*rgb(GOAL_COLOUR), 70]))

    def airframe(self) -> None:
        log = self.flight.log
        self.columns("world/airframe", rr.Transform3D.columns(translation=z_up(log.pos_m),
                                                              quaternion=quaternion_z_up(log.quat)))
        vertices, triangles, colours = airframe_mesh(log.airframe)
        self.fixed("world/airframe/body", rr.Mesh3D(vertex_positions=z_up(vertices), triangle_indices=triangles,
                                                    vertex_colors=colours))
        reach = RANGE_COLUMNS * COLUMN_M
        angle = np.linspace(-_FAN_HALF_ANGLE_RAD, _FAN_HALF_ANGLE_RAD, 41)
        rim = np.stack([reach * np.cos(angle), reach * np.sin(angle), 0 * angle], axis=1)
        fan = z_up(np.concatenate([np.zeros((1, 3)), rim]) + SONAR_ORIGIN_M)
        faces = [[0, k, k + 1] for k in range(1, len(angle))]
        self.fixed("world/airframe/sonar_reach", rr.Mesh3D(vertex_positions=fan, triangle_indices=faces,
                                                           albedo_factor=[*rgb(PATH_COLOUR), 38]))
        self.fixed("world/airframe/sonar_reach/rim", rr.LineStrips3D([fan[1:]], colors=rgb(PATH_COLOUR),
                                                                     radii=-0.7))

    def path(self) -> None:
        points = z_up(self.flight.log.pos_m)
        colour = rgb(PATH_COLOUR)
        self.fixed("world/path", rr.LineStrips3D([points], colors=[*colour, 90], radii=-0.6))
        previous = np.concatenate([points[:1], points[:-1]])
        self.columns("world/trail", rr.LineStrips3D.columns(
            strips=np.stack([previous, points], axis=1), colors=[colour] * len(points), radii=[-1.7] * len(points)))
        foot = points * (1.0, 1.0, 0.0) + (0.0, 0.0, 0.015)
        self.columns("world/plumb_line", rr.LineStrips3D.columns(
            strips=np.stack([points, foot], axis=1), colors=[(150, 160, 178)] * len(points),
            radii=[-0.5] * len(points)))
        self.columns("world/plumb_line/foot", rr.Points3D.columns(positions=foot, colors=[colour] * len(points),
                                                                  radii=[-3.0] * len(points)))
        end = self.flight.end_tick
        result = self.flight.result
        words = OUTCOME_WORDS.get(result.outcome, result.outcome)
        self.recording.set_time(TIMELINE, duration=float(self.flight.time_s[end]))
        self.recording.log("world/outcome", rr.Points3D(
            [points[end]], radii=-7.0, colors=rgb(outcome_colour(result.outcome)),
            labels=[viewer_text(words + (f": {result.part}" if result.part else ""))]))
        self.recording.reset_time()

    def detections(self) -> None:
        found = self.flight.detections_m
        counts = [len(points) for points in found]
        everything = z_up(np.concatenate([*found, np.zeros((0, 3))]))
        self.columns("world/detections", rr.Points3D.columns(positions=everything).partition(counts))
        self.fixed("world/detections", rr.Points3D.from_fields(radii=-4.0, colors=rgb(DETECTION_COLOUR)))

    def sonar(self, side: str, rows: NDArray[np.uint8], edges: NDArray[np.uint8]) -> None:
        """A rolling image of the last HISTORY_ROWS ticks: newest row at the bottom, range to the right."""
        ticks, columns = rows.shape
        if columns == 0:
            return
        image = f"sonar_{side}/image"
        # a depth image draws 0 as "no depth" in a colour of its own, so the quietest is 1
        padded = np.maximum(np.concatenate([np.zeros((HISTORY_ROWS - 1, columns), dtype=np.uint8), rows]), 1)
        window = np.lib.stride_tricks.sliding_window_view(padded, HISTORY_ROWS, axis=0).transpose(0, 2, 1)
        stretch = rr.Transform3D(scale=[RANGE_COLUMNS / columns, ROW_STRETCH, 1.0])
        self.fixed(image, stretch, rr.DepthImage.from_fields(
            format=rr.components.ImageFormat(width=columns, height=HISTORY_ROWS, channel_datatype="U8"),
            colormap="inferno", depth_range=echo_shades(rows)))
        self.columns(image, rr.DepthImage.columns(buffer=window.reshape(ticks, -1)))
        seen = [edge_columns(row) for row in edges]
        points, counts = [], []
        for tick in range(ticks):
            first = max(0, tick - HISTORY_ROWS + 1)
            now = [np.stack([seen[k] + 0.5, np.full(len(seen[k]), HISTORY_ROWS - 0.5 - (tick - k))], axis=1)
                   for k in range(first, tick + 1)]
            points.append(np.concatenate(now))
            counts.append(len(points[-1]))
        self.columns(f"{image}/edges", rr.Points2D.columns(positions=np.concatenate(points)).partition(counts))
        self.fixed(f"{image}/edges", rr.Points2D.from_fields(radii=-1.8, colors=_EDGE_COLOUR, draw_order=20.0))
        self._range_ticks(side)

    def _range_ticks(self, side: str) -> None:
        marks_m = np.arange(0.0, RANGE_COLUMNS * COLUMN_M, 0.25)
        at = marks_m / COLUMN_M
        bottom = HISTORY_ROWS * ROW_STRETCH
        lines = [[(x, bottom), (x, bottom + (6 if m % 0.5 == 0 else 3))] for x, m in zip(at, marks_m, strict=True)]
        self.fixed(f"sonar_{side}/range_ticks", rr.LineStrips2D(lines, colors=[160, 170, 185], radii=-0.6))
        named = [m for m in marks_m if m % 0.5 == 0]
        self.fixed(f"sonar_{side}/range_ticks/metres", rr.Points2D(
            [(m / COLUMN_M, bottom + 6) for m in named], radii=-0.1, colors=[200, 208, 220],
            labels=[f"{m:g} m" for m in named], show_labels=True))

    def plots(self) -> None:
        flight = self.flight
        flown, commanded = heading_velocity_m_s(flight.log), sent_commands(flight.log)
        for axis, name in enumerate(("forward", "right", "down")):
            self._series(f"velocity/{name}/flown", flown[:, axis], "flown", (120, 130, 145), 1.5)
            self._series(f"velocity/{name}/commanded", commanded[:, axis], "commanded",
                         rgb(PATH_COLOUR), 2.0)
        if flight.scene.obstacles:
            self._series("distance/nearest_obstacle", flight.centre_distance_m, "airframe centre to surface",
                         rgb(kind_colour("cylinder")), 2.0)
            half_m = float(flight.log.airframe.get("wheelbase_m", 0.16)) / 2 \
                + float(flight.log.airframe.get("prop_diameter_m", 0.0762)) / 2
            self._series("distance/airframe_radius", np.full(len(flight.time_s), half_m), "airframe's own radius",
                         rgb(outcome_colour("obstacle_hit")), 1.5)

    def _series(self, entity: str, values: NDArray[np.float64], name: str, colour: tuple[int, int, int],
                width: float) -> None:
        self.fixed(entity, rr.SeriesLines(names=name, colors=colour, widths=width))
        self.columns(entity, rr.Scalars.columns(scalars=values))

    def texts(self) -> None:
        flight = self.flight
        verdict = viewer_text(flight_markdown(flight.result))
        self.fixed("verdict", rr.TextDocument(verdict, media_type=rr.MediaType.MARKDOWN))
        first_s = float(flight.time_s[0])
        entries = [(t_us * 1e-6, text, "INFO") if t_us * 1e-6 >= first_s  # nothing else is drawn before the first tick
                   else (first_s, f"at {t_us * 1e-6:.2f} s: {text}", "INFO") for t_us, text in flight.log.events]
        result = flight.result
        level = "INFO" if result.success_strict else "WARN" if result.success_lenient else "ERROR"
        entries.append((float(flight.time_s[flight.end_tick]), f"{result.outcome}: {result.cause}", level))
        entries.sort(key=lambda entry: entry[0])
        texts = [viewer_text(text) for _, text, _ in entries]
        self.columns("events", rr.TextLog.columns(text=texts, level=[e[2] for e in entries]),
                     [rr.TimeColumn(TIMELINE, duration=[e[0] for e in entries])])


def _face_normals(flat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Outward-or-inward unit normal of every triangle, repeated for its three corners."""
    corners = flat.reshape(-1, 3, 3)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.repeat(normal / np.where(length > 0, length, 1.0), 3, axis=0)


def _circle(centre: NDArray[np.float64], radius_m: float) -> NDArray[np.float64]:
    angle = np.linspace(0, 2 * np.pi, 33)
    return centre + np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), 0 * angle], axis=1)
