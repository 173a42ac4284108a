"""Where every echo of a flight came from, worked out again from the poses in its log.

The acoustics are a pure function of pose and velocity, so nothing needs to be recorded in flight: at each tick of the
log the same model gives every arrival with the obstacle that made it, its path and its strength against the noise.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from saranga.echo import load_sonar
from sitl.acoustics.arrival import CYLINDER, DIRECT, EDGE, FACET, SPHERE
from sitl.acoustics.shield import load_shielding
from sitl.acoustics.sonar import AcousticModel
from sitl.scene import Scene, build_scene, load_scene
from sitl.trial_types import FlightLog, TrialRequest

GROUND, NO_OBSTACLE = -1, -2
KINDS = {FACET: "facet", CYLINDER: "cylinder", EDGE: "edge", DIRECT: "direct", SPHERE: "sphere"}


@dataclass(frozen=True)
class EchoProvenance:
    """One row an arrival (K,): t_us; role (index into `roles`); obstacle (index into the scene's, -1 the ground, -2 the
    direct sound); kind (`sitl.acoustics.tracing`); path_m; amplitude_counts; noise_rms_counts."""

    roles: tuple[str, ...]
    t_us: NDArray[np.int64]
    role: NDArray[np.int64]
    obstacle: NDArray[np.int64]
    kind: NDArray[np.float64]
    path_m: NDArray[np.float64]
    amplitude_counts: NDArray[np.float64]
    noise_rms_counts: NDArray[np.float64]

    def save(self, to: Path | IO[bytes]) -> None:
        """Write as .npz."""
        np.savez_compressed(to, **{**vars(self), "roles": np.array(self.roles)})

    @staticmethod
    def load(path: Path) -> "EchoProvenance":
        """Read what `save` wrote."""
        with np.load(path, allow_pickle=False) as stored:
            values = {name: stored[name] for name in stored.files}
        return EchoProvenance(**{**values, "roles": tuple(map(str, values["roles"]))})


def provenance_of(log: FlightLog, request: TrialRequest) -> EchoProvenance:
    """Every arrival at every sensor at each tick of a flight.

    Raises:
        UsageError: the request names a scene, sonar or shield that is not there.
    """
    scene = build_scene(load_scene(request.scene), request.seed)
    geometry = load_sonar(request.sonar)
    model = AcousticModel(scene.primitives, scene.weather, geometry, load_shielding(request.shield), request.seed)
    owners = owners_of(scene)
    rows = []
    for k in range(len(log.t_us)):
        for index, role in enumerate(geometry.roles):
            noise = model.noise_rms_counts(role, log.thrust_n[k])
            for arrival in model.arrivals(role, log.pos_m[k], log.quat[k], log.vel_m_s[k],
                                          t_us=int(log.t_us[k]), thrust_n=log.thrust_n[k]):
                kind, number = float(arrival[5]), int(arrival[6])
                owner = NO_OBSTACLE if kind == DIRECT else int(owners[KINDS[kind]][number])
                rows.append((log.t_us[k], index, owner, kind, arrival[4],
                             model.gain_counts * float(np.hypot(arrival[1], arrival[2])), noise))
    columns = np.array(rows, dtype=np.float64).reshape(-1, 7).T
    return EchoProvenance(geometry.roles, columns[0].astype(np.int64), columns[1].astype(np.int64),
                          columns[2].astype(np.int64), *columns[3:])


def owners_of(scene: Scene) -> dict[str, NDArray[np.int64]]:
    """For each row of the scene's facets, cylinders and edges the obstacle it belongs to; -1 is the ground."""
    owners: dict[str, list[int]] = {"facet": [], "cylinder": [], "edge": [], "sphere": []}
    for index, shape in enumerate(scene.obstacles):
        parts = shape.primitives()
        for kind, array in (("facet", parts.facets), ("cylinder", parts.cylinders), ("edge", parts.edges),
                            ("sphere", parts.spheres)):
            owners[kind] += [index] * len(array)
    lengths = {"facet": len(scene.primitives.facets), "cylinder": len(scene.primitives.cylinders),
               "edge": len(scene.primitives.edges), "sphere": len(scene.primitives.spheres)}
    return {kind: np.array(found + [GROUND] * (lengths[kind] - len(found)), dtype=np.int64)
            for kind, found in owners.items()}
