"""The configuration: models, and load(), which reports every error at once with file, line and column."""

from softplc.config.axis import Axis
from softplc.config.models import Config, Task

__all__ = ["Axis", "Config", "Task"]
