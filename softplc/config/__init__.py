"""The configuration: models, and load(), which reports every error at once with file, line and column."""

from softplc.config.models import Axis, Config, Task

__all__ = ["Axis", "Config", "Task"]
