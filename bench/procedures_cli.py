"""`saranga-bench beam`, `reference-echo`, `accuracy` and `energy`: procedures in which nothing spins."""

import typer


def add_commands(app: typer.Typer) -> None:
    """Hang the commands on the main application."""
