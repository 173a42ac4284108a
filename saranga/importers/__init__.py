"""Formats of other people's echo logs, one file each, found by its `NAME`.

A format is a module with `NAME`, `LOOKS` (what such a file looks like, for people), `recognises(first_line)` and
`build(**options)`, which returns `read(path) -> ImportedLog`.
"""
