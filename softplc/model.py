"""What all configuration models share: frozen, unknown keys forbidden, secrets that are never in the file."""

import os
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationInfo, model_validator

from softplc.errors import ConfigError

# In json_schema_extra: x-unit is the unit of a number (`unit` stands for the axis' own), x-expected says in words
# what a pattern asks for, x-secret marks what is never shown. The configuration's error texts are made of them.
Name = Annotated[
    str,
    StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$", max_length=64),
    Field(
        json_schema_extra={
            "x-expected": "a name of at most 64 letters, digits, _ and -, which starts with a letter or _"
        }
    ),
]
"""A name that is also a part of node ids and metric labels: letters, digits, _ and -, no dots."""

Host = Annotated[
    str,
    StringConstraints(pattern=r"^[^\s/@]+$", max_length=253),
    Field(json_schema_extra={"x-expected": "a host name or an address, as in plc1.local or 192.168.0.10"}),
]
"""Where a device is, or where a server listens."""


def _from_the_folder(path: str, info: ValidationInfo) -> str:
    return str(Path(info.context["folder"]) / path) if info.context else path


PathBeside = Annotated[str, Field(min_length=1), AfterValidator(_from_the_folder)]
"""A path, in the file as seen from the configuration's folder; the validation's context says which that is."""


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

    model_config = ConfigDict(json_schema_extra={"x-secret": True, "minProperties": 1, "maxProperties": 1})

    env: Annotated[str, Field(min_length=1)] | None = None
    """Name of the environment variable that holds the secret."""
    file: Annotated[str, Field(min_length=1)] | None = None
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
