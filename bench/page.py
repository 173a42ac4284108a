"""Writing a page from its template: whole or not at all."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from saranga.errors import BenchError


def write_page_file(path: Path, template: str, filters: Mapping[str, Callable[..., Any]], **values: Any) -> Path:
    """Render `bench/templates/TEMPLATE` with `values` into `path`.

    Raises:
        BenchError: the page cannot be written.
    """
    environment = Environment(loader=PackageLoader("bench", "templates"), autoescape=True, undefined=StrictUndefined,
                              trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(filters)
    page = environment.get_template(template).render(**values)
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(page, encoding="utf-8")
        return part.replace(path)
    except OSError as error:
        raise BenchError(f"{path}: cannot be written: {error.strerror}") from error
