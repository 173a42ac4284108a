"""The link to each sensor: it sends a sequence that both ends know, and its built-in test."""

from collections.abc import Callable

from bench.rig.evidence import Evidence, Finding

NAME = "link"


def build() -> Callable[[Evidence], list[Finding]]:
    return examine


def examine(evidence: Evidence) -> list[Finding]:
    found = []
    for role in evidence.roles:
        wrong = evidence.link_wrong.get(role)
        came = "did not come" if wrong is None else "came back wrong"
        found.append(Finding("link_wrong_share", 1.0 if wrong is None else wrong, "1", of=role,
                             cause=f"the {role} sensor's link test {came}: check its cable and its SPI bus"))
    for sensor in evidence.tested.sensors if evidence.tested else ():
        if sensor.role:
            failed = {"pass": 0.0, "fail": 1.0}.get(sensor.self_test)
            found.append(Finding("self_test_failed", failed, "1", of=sensor.role,
                                 cause=f"the {sensor.role} sensor fails its built-in test: replace it"))
    return found
