"""A campaign goes on only with what it began with, files given by path included."""

import shutil
from dataclasses import replace
from pathlib import Path

from bench.campaign.identity import identity_of
from saranga.fixtures import fixture_path
from sitl.trial_types import TrialRequest


def test_a_shield_scene_or_sonar_that_was_edited_is_another(tmp_path: Path) -> None:
    for kind, name, key in (("shields", "foam", "shield"), ("scenes", "wall", "scene"), ("sonars", "pair", "sonar")):
        file = tmp_path / f"{name}.toml"
        shutil.copy(fixture_path(kind, name), file)
        request = replace(TrialRequest(scene="poles", seed=1), **{key: str(file)})
        before = identity_of([request])
        assert before == identity_of([request, request])
        file.write_text(file.read_text() + "\n# another\n")
        assert identity_of([request])["sources"] != before["sources"], key
        assert identity_of([request])["weights"] == before["weights"]
