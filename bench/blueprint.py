"""How a flight's recording is laid out in the viewer, so that it reads at first sight.

The course from behind and above fills most of the window, what both sonars heard lies beneath it, and the verdict,
commanded against flown velocity, the distance to the nearest obstacle and the events stand at the right.
"""

import rerun.blueprint as rrb

from bench.drawing import DrawnScene

TIMELINE = "sim_time"
_NIGHT = [13, 16, 22]


def flight_blueprint(scene: DrawnScene, image_width: float, image_height: float) -> rrb.Blueprint:
    """The layout of one flight.

    Args:
        scene: for the eye: where the course lies.
        image_width, image_height: extent of an echo image in its view's own units, ticks included.
    """
    since_start = rrb.VisibleTimeRange(TIMELINE, start=rrb.TimeRangeBoundary.infinite(),
                                       end=rrb.TimeRangeBoundary.cursor_relative())
    last_second = rrb.VisibleTimeRange(TIMELINE, start=rrb.TimeRangeBoundary.cursor_relative(seconds=-1.0),
                                       end=rrb.TimeRangeBoundary.cursor_relative())
    course = rrb.Spatial3DView(
        origin="/world", name="Course", background=rrb.archetypes.Background(color=_NIGHT),
        line_grid=rrb.archetypes.LineGrid3D(visible=False), eye_controls=course_eye(scene),
        overrides={
            "/world/trail": rrb.archetypes.VisibleTimeRanges([since_start]),
            "/world/detections": rrb.archetypes.VisibleTimeRanges([last_second]),
        })
    bounds = rrb.archetypes.VisualBounds2D(x_range=[-0.02 * image_width, 1.02 * image_width],
                                           y_range=[-0.02 * image_height, 1.02 * image_height])
    sonars = [rrb.Spatial2DView(origin=f"/sonar_{side}", name=f"{side.capitalize()} sonar: echoes, last 2 s",
                                background=rrb.archetypes.Background(color=_NIGHT), visual_bounds=bounds)
              for side in ("left", "right")]
    no_legend = rrb.archetypes.PlotLegend(visible=False)
    plots = [
        rrb.TimeSeriesView(origin="/velocity/forward", name="Forward m/s: blue commanded, grey flown",
                           plot_legend=no_legend),
        rrb.TimeSeriesView(origin="/velocity/right", name="Sideways m/s: blue commanded, grey flown",
                           plot_legend=no_legend),
        rrb.TimeSeriesView(origin="/distance", name="Nearest obstacle m: red own radius", plot_legend=no_legend,
                           axis_y=rrb.archetypes.ScalarAxis(range=(0.0, 2.0))),
    ]
    climb = rrb.TimeSeriesView(origin="/velocity/down", name="Down m/s", plot_legend=no_legend)
    column = rrb.encodings.TextLogColumn
    events = rrb.TextLogView(origin="/events", name="Events", columns=rrb.archetypes.TextLogColumns(
        timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE)],
        text_log_columns=[column("EntityPath", visible=False), column("LogLevel", visible=False), column("Body")]))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(course, rrb.Horizontal(*sonars), row_shares=[2.35, 1]),
            rrb.Vertical(
                rrb.TextDocumentView(origin="/verdict", name="Verdict"),
                *plots, rrb.Tabs(events, climb), row_shares=[1.9, 1, 1, 1, 1]),
            column_shares=[3.1, 1]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="playing"),
        rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden"), rrb.TopPanel(state="hidden"),
        auto_layout=False, auto_views=False)


def course_eye(scene: DrawnScene) -> rrb.archetypes.EyeControls3D:
    """An eye behind, right of and above the start, looking along the course; scales with the arena."""
    (x0, x1), (y0, y1) = scene.x_m, scene.y_m
    middle_y = -(y0 + y1) / 2
    reach = max((x1 - x0) / 11.0, (y1 - y0) / 4.5)
    return rrb.archetypes.EyeControls3D(
        position=(x0 + 1.9 * reach, middle_y - 4.9 * reach, 4.7 * reach),
        look_target=(x0 + 0.455 * (x1 - x0), middle_y, 0.35 * reach), eye_up=(0.0, 0.0, 1.0))
