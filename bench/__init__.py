"""The harness and the hardware: pytest plugin, command line, verdicts, journal, reports."""
