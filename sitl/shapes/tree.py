"""A tree: trunk, branches that lean upwards, and leaves as small flat sheets at the ends of the branches."""

import math
from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import Field

from sitl.materials import load_material
from sitl.primitives import Primitives, cylinder_row, facet_row
from sitl.shapes.base import Floats, ShapeTable, Triangles
from sitl.shapes.cylinder import Cylinder
from sitl.solids import cylinder_solid
from sitl.validation import OrderedPair, OrderedRange, Positive

LEAF_MATERIAL = "leaf"
LEAF_SPREAD_M = 0.15
"""Leaves lie within this of the branch's end."""


class Tree(ShapeTable):
    """Trunk and branches are solid, leaves only reflect: a propeller cuts through a leaf.

    Attributes:
        x_m, y_m: of the trunk.
        diameter_m, height_m: of the trunk.
        branches, branch_height_m: how many, and where they leave the trunk.
        branch_length_m, branch_diameter_m: drawn uniformly.
        leaves, leaf_size_m: a branch; half the side of the square.
        seed: of branches and leaves.
    """

    kind: Literal["tree"] = "tree"
    material: str = "bark"
    x_m: float
    y_m: float
    diameter_m: Positive = 0.25
    height_m: Positive = 6.0
    branches: int = Field(default=4, ge=0, le=40)
    branch_height_m: OrderedPair = (1.7, 4.0)
    branch_length_m: OrderedRange = (0.3, 0.9)
    branch_diameter_m: OrderedRange = (0.01, 0.03)
    leaves: int = Field(default=6, ge=0, le=200)
    leaf_size_m: Positive = 0.02
    seed: int = Field(default=0, ge=0)

    @cached_property
    def _branches(self) -> list[tuple[Floats, Floats, float]]:
        """Ends and radius, world NED."""
        rng = np.random.default_rng(self.seed)
        out = []
        for _ in range(self.branches):
            at = min(float(rng.uniform(*self.branch_height_m)), self.height_m)
            turn, rise = float(rng.uniform(0.0, 2.0 * math.pi)), math.radians(float(rng.uniform(10.0, 60.0)))
            along = np.array([math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn), -math.sin(rise)])
            root = np.array([self.x_m, self.y_m, -at])
            length = float(rng.uniform(*self.branch_length_m)) + 0.5 * self.diameter_m
            out.append((root, root + length * along, 0.5 * float(rng.uniform(*self.branch_diameter_m))))
        return out

    def _trunk(self) -> Cylinder:
        return Cylinder(x_m=self.x_m, y_m=self.y_m, diameter_m=self.diameter_m, height_m=self.height_m,
                        material=self.material)

    def solids(self) -> Floats:
        rows = [cylinder_solid(root, end, radius) for root, end, radius in self._branches]
        return np.array([*self._trunk().solids(), *rows])

    def primitives(self) -> Primitives:
        """Trunk and branches as cylinders, leaves as facets in random directions."""
        r, rough = self.reflectivity, self.albedo
        rng = np.random.default_rng([self.seed, 1])
        leaf = load_material(LEAF_MATERIAL).reflectivity
        facets = []
        for _, end, _ in self._branches:
            for _ in range(self.leaves):
                u, v, _ = np.linalg.qr(rng.normal(size=(3, 3)))[0].T
                centre = end + rng.uniform(-LEAF_SPREAD_M, LEAF_SPREAD_M, 3)
                facets.append(facet_row(centre, u, v, self.leaf_size_m, self.leaf_size_m, leaf))
        return Primitives.of(facets=facets, cylinders=[
            *self._trunk().primitives().cylinders.tolist(),
            *(cylinder_row(root, end, radius, r, rough) for root, end, radius in self._branches)])

    def mesh(self) -> tuple[Floats, Triangles]:
        """Trunk and branches."""
        parts = [self._trunk(), *(
            Cylinder(diameter_m=2 * radius, end_a_m=tuple(root * (1, 1, -1)), end_b_m=tuple(end * (1, 1, -1)),
                     material=self.material) for root, end, radius in self._branches)]
        vertices, triangles, count = [], [], 0
        for part in parts:
            points, faces = part.mesh()
            vertices.append(points)
            triangles.append(faces + count)
            count += len(points)
        return np.concatenate(vertices), np.concatenate(triangles)

    def describe(self) -> str:
        return f"tree at x {self.x_m:.2f} m, y {self.y_m:.2f} m"


SHAPE = Tree
