"""Training recipes, as data (`fixtures/training/*.toml`)."""

import hashlib
import json
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml
from saranga.synthesis import Recipe, load_recipe

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Name = Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z0-9._-]+$")]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class NetworkTable(_Table):
    """Which network, and the name it is shipped by."""

    name: Name
    architecture: Literal["tracks", "paper"]


class ExtraTable(_Table):
    """A second synthesis recipe, for a share of the pairs."""

    share: Share
    synthesis: str
    set: dict[str, Any]


class DataTable(_Table):
    """Pairs a pass, passes, and the synthesis recipe they are drawn from with what is changed in it."""

    synthesis: str
    pairs: Annotated[int, Field(ge=1, le=10**9)]
    epochs: Annotated[int, Field(ge=1, le=10_000)]
    seed: Annotated[int, Field(ge=0, lt=2**31)]
    amplitude_only_share: Share
    set: dict[str, Any]
    extra: ExtraTable | None = None


class OptimiserTable(_Table):
    """Adam or AdamW; the rate rises over the warm-up and then stays or falls to zero as half a cosine."""

    name: Literal["adam", "adamw"]
    rate: Annotated[float, Field(gt=0.0, le=1.0)]
    weight_decay: Annotated[float, Field(ge=0.0, le=1.0)]
    batch: Annotated[int, Field(ge=2, le=4096)]
    warm_up_steps: Annotated[int, Field(ge=0, le=100_000)]
    decay: Literal["none", "cosine"]


class LossTable(_Table):
    """Mean squared error of the probability, or binary cross-entropy; an edge weighs `edge_weight` empty columns."""

    kind: Literal["mse", "bce"]
    edge_weight: Annotated[float, Field(gt=0.0, le=1000.0)]


class TrainingRecipe(_Table):
    """All that decides what a network becomes."""

    network: NetworkTable
    data: DataTable
    optimiser: OptimiserTable
    loss: LossTable

    @property
    def sha256(self) -> str:
        """Of this recipe and of the synthesis recipe it names, whatever the layout of the files."""
        extra = self.extra_synthesis()
        tables = {"training": self.model_dump(), "synthesis": self.synthesis().tables,
                  "extra": extra.tables if extra else None}
        return hashlib.sha256(json.dumps(tables, sort_keys=True).encode()).hexdigest()

    @property
    def images(self) -> int:
        """Images to be seen in all."""
        return self.data.pairs * self.data.epochs

    def synthesis(self) -> Recipe:
        """The synthesis recipe with the changes made.

        Raises:
            UsageError: unknown recipe or value.
        """
        return load_recipe(self.data.synthesis).with_values(self.data.set)

    def extra_synthesis(self) -> Recipe | None:
        """The second recipe with its changes, if there is one.

        Raises:
            UsageError: unknown recipe or value.
        """
        extra = self.data.extra
        return load_recipe(extra.synthesis).with_values(extra.set) if extra else None


def load_training_recipe(name: str) -> TrainingRecipe:
    """Load by fixture name ("default", "paper") or path.

    Raises:
        UsageError: unknown name, malformed file, or a value out of its limits (file, key, value, limit).
    """
    path = fixture_path("training", name)
    return parse_training_recipe(load_toml(path), str(path))


def parse_training_recipe(tables: dict[str, Any], source: str) -> TrainingRecipe:
    """Check tables as read from TOML; `source` is named in errors.

    Raises:
        UsageError: see `load_training_recipe`.
    """
    try:
        recipe = TrainingRecipe.model_validate(tables)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        value = "" if first["type"] in ("missing", "extra_forbidden") else f" is {first['input']!r}"
        raise UsageError(f"{source}: {where}{value}: {first['msg']}; see fixtures/training/default.toml") from None
    recipe.synthesis()
    recipe.extra_synthesis()
    return recipe
