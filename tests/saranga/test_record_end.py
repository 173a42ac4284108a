"""The end of the record: filters reach over it, and what they make of it is no obstacle."""

import numpy as np

from saranga.stack import END_COLUMNS, _before_the_end
from sitl.trial import run_trial
from sitl.trial_types import TrialRequest


def test_edges_at_the_end_of_what_was_measured_are_dropped_and_no_others() -> None:
    envelope = np.zeros((32, 512), np.float32)
    envelope[5, :510] = 1.0
    row = np.ones(512, np.float32)
    kept = _before_the_end(row, envelope)
    assert kept[:510 - END_COLUMNS].all() and not kept[510 - END_COLUMNS:].any()
    assert row.all()
    assert not _before_the_end(row, np.zeros((32, 512), np.float32)).any()


def test_in_an_open_hall_nothing_is_dodged() -> None:
    log = run_trial(TrialRequest("open", seed=1, denoiser="tbd")).log
    assert log is not None
    sideways = np.abs(log.command[np.array(log.phase) == "course", 1])
    assert (sideways > 0.3).mean() < 0.1
