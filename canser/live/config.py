"""What is asked of a port, as value objects."""

from collections.abc import Mapping
from typing import Any

from canser._checks import instance
from canser.adapters import AdapterConfig

__all__ = ["adapter_config", "flat_config"]


def adapter_config(bitrate: int | None, config: AdapterConfig | None) -> AdapterConfig | None:
    """Return the configuration that a bitrate or a config asks for; None if both are None."""
    if config is None:
        return None if bitrate is None else AdapterConfig(bitrate=bitrate)
    instance(config, "config", AdapterConfig)
    if bitrate is not None:
        raise ValueError(
            f"bitrate is {bitrate}, but config has the bitrate {config.bitrate}; give one of both"
        )
    return config


def flat_config(options: Mapping[str, Any]) -> AdapterConfig | None:
    """Return the configuration whose fields are given as flat options, None for no option.

    A bitrate of None counts as not given.
    """
    given = {name: value for name, value in options.items() if (name, value) != ("bitrate", None)}
    if not given:
        return None
    if "bitrate" not in given:
        raise ValueError("the adapter is configured as a whole: give its bitrate, too")
    return AdapterConfig(**given)
