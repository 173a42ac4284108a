"""What is held to the contract: a denoiser or a policy, found by name, made anew as often as a test wants."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from saranga.denoise import Denoiser, denoiser_names, load_denoiser
from saranga.errors import UsageError
from saranga.navigate import EchoPolicy, Policy, load_policy, policy_names, sonar_of
from saranga.plugins import user_target

DENOISER, POLICY = "denoiser", "policy"


@dataclass(frozen=True)
class Subject:
    """`spec` as it was given; `make()` gives a fresh one (an instance named by MODULE:NAME stays the same)."""

    kind: str
    spec: str

    @property
    def id(self) -> str:
        return f"{self.kind}={self.spec}"

    def make(self) -> Any:
        return load_denoiser(self.spec) if self.kind == DENOISER else load_policy(self.spec)

    @property
    def sonar(self) -> str:
        return sonar_of(self.spec) if self.kind == POLICY else "pair"


def find_subjects(specs: list[str]) -> list[Subject]:
    """What the names are. A shipped name that is a denoiser and a stack (saranga) gives both.

    Raises:
        UsageError: nothing of that name, or neither of the two.
    """
    found = [subject for spec in specs for subject in (_user_subject(spec) if ":" in spec else _shipped(spec))]
    return list(dict.fromkeys(found))


def _shipped(name: str) -> list[Subject]:
    found = [Subject(kind, name) for kind, names in ((DENOISER, denoiser_names()), (POLICY, policy_names()))
             if name in names]
    if not found:
        raise UsageError(f"--bench-contract {name}: no denoiser ({', '.join(denoiser_names())}) and no stack "
                         f"({', '.join(policy_names())}); give your own as MODULE:NAME")
    return found


def _user_subject(spec: str) -> list[Subject]:
    """By what it offers: a policy decides, a denoiser is called with an image and has a threshold."""
    target = user_target("contract", spec)
    decides = callable(getattr(target, "decide", None))
    judges = hasattr(target, "threshold")
    if decides != judges:
        return [Subject(POLICY if decides else DENOISER, spec)]
    tried: dict[str, str] = {}
    loaders: tuple[tuple[str, Callable[[str], Any], type], ...] = (
        (POLICY, load_policy, Policy), (DENOISER, load_denoiser, Denoiser))
    for kind, load, protocol in loaders:
        try:
            if isinstance(load(spec), protocol):
                return [Subject(kind, spec)]
        except UsageError as error:
            tried[kind] = str(error)
    raise UsageError(f"--bench-contract {spec}: neither a denoiser nor a policy: " + "; ".join(tried.values()))


def is_echo_policy(policy: Any) -> bool:
    return isinstance(policy, EchoPolicy)
