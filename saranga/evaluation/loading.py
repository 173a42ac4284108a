"""The denoisers to compare, and why some of those that have a name cannot be."""

from collections.abc import Sequence

from saranga.denoise import Denoiser, denoiser_names, load_denoiser
from saranga.errors import BenchError, UsageError
from saranga.evaluation.answering import warm_up


def load_denoisers(names: Sequence[str] | None) -> tuple[dict[str, Denoiser], dict[str, str]]:
    """(denoisers by name, reason by name of what was skipped).

    Args:
        names: None takes all that can be loaded; one that is named must load.

    Raises:
        UsageError: an unknown name, a name twice, or none left. BenchError: a named one that cannot run here.
    """
    wanted = list(names) if names is not None else denoiser_names()
    if len(set(wanted)) != len(wanted) or not wanted:
        raise UsageError(f"denoisers are {', '.join(wanted) or 'none'}: name each wanted one once")
    loaded: dict[str, Denoiser] = {}
    skipped: dict[str, str] = {}
    for name in wanted:
        try:
            denoiser = load_denoiser(name)
            warm_up(denoiser)
        except (BenchError, ImportError, OSError) as error:
            if names is not None and isinstance(error, BenchError):
                raise
            if names is not None:
                raise BenchError(f"denoiser {name!r} cannot be loaded: {error}") from error
            skipped[name] = str(error) or type(error).__name__
        else:
            loaded[name] = denoiser
    if not loaded:
        raise UsageError("no denoiser can be loaded: " + "; ".join(f"{n}: {why}" for n, why in skipped.items()))
    return loaded, skipped
