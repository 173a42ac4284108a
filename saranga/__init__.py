"""The stack under test: echoes -> image -> denoise -> localise -> navigate -> MAVLink."""

__version__ = "0.1.0"
