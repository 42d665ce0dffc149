"""What all configuration models share: frozen, unknown keys forbidden, secrets that are never in the file."""

import os
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, StringConstraints, model_validator

from softplc.errors import ConfigError

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$", max_length=64)]
"""A name that is also a part of node ids and metric labels: letters, digits, _ and -, no dots."""


class Model(BaseModel):
    """Base of every configuration model. Strict: a string is not a number, a number is not a truth value."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        validate_default=True,
    )


class Secret(Model):
    """Where a secret is to be found: an environment variable or a file, never the configuration itself."""

    env: str | None = None
    """Name of the environment variable that holds the secret."""
    file: str | None = None
    """Path of a file whose first line is the secret."""

    @model_validator(mode="after")
    def _one_place(self) -> "Secret":
        if (self.env is None) == (self.file is None):
            raise ValueError("expected exactly one of env and file")
        return self

    def read(self) -> str:
        """The secret itself. Raises ConfigError when it is not where the configuration says."""
        if self.env is not None:
            value = os.environ.get(self.env)
            if value is None:
                raise ConfigError(f"environment variable {self.env} is not set; it must hold the secret")
            return value
        path = Path(self.file or "")
        try:
            return path.read_text(encoding="utf-8").split("\n", 1)[0]
        except OSError as error:
            raise ConfigError(f"{path}: cannot read the secret: {error.strerror}") from error
