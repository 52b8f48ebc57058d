"""How much of a file, a picture, time and memory a frame may take."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from circlecal.files import MAX_BYTES

_BYTES_PER_PIXEL = 3


class LimitsConfig(BaseModel):
    """Limits of what comes from outside: they change no answer, only whether there is one."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    max_pixels: int = Field(
        50_000_000,
        ge=4096,
        le=1_000_000_000,
        description="Largest picture, pixels of 8 bit; one of 16 bit takes twice the memory and counts twice. 8K has "
        "33 million.",
    )
    max_bytes: int = Field(
        MAX_BYTES, ge=1024, le=1 << 34, description="Largest file of a picture, and answer of a server, bytes."
    )
    frame_seconds: float = Field(
        120.0, gt=0, le=86400, description="Longest time for one frame; one that takes longer is refused."
    )
    memory_mb: int | None = Field(
        None,
        ge=256,
        description="Most memory that a worker of `circlecal batch` may take, megabytes (Linux); null for no limit.",
    )
    server_seconds: float = Field(
        20.0,
        gt=0,
        le=3600,
        description="Longest time that a server is waited for, and that a scheduler without workers is.",
    )

    @property
    def max_decoded_bytes(self) -> int:
        """Largest picture once decoded."""
        return _BYTES_PER_PIXEL * self.max_pixels

    @staticmethod
    def pixels_of(decoded_bytes: int) -> int:
        """As how many pixels of 8 bit a picture counts that takes so many bytes once decoded."""
        return -(-decoded_bytes // _BYTES_PER_PIXEL)


DEFAULT_LIMITS = LimitsConfig()


def suggest_limit(name: str, needed: object = "N") -> str:
    """What helps where something is larger than a limit, in words that every command and the library understand."""
    return f"scale it down or raise limits.{name} (--set limits.{name}={needed})"
