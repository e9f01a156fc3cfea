"""The arguments that name a live port, and how one is opened by them."""

import argparse
import re
from typing import Final

from canser import adapters
from canser._protocols import TS_UNITS, protocol, protocols
from canser._signals import Stop
from canser.adapters import AdapterConfig
from canser.commands._numbers import duration, whole
from canser.commands._parser import CallError, Parser, protocol_name
from canser.errors import PortBusyError, PortDeniedError, PortNotFoundError
from canser.live import ports
from canser.live.config import LEVELS, LineConfig, PortOptions, flat_config
from canser.live.ports import Port

__all__ = ["duration_arguments", "open_port", "port_arguments", "port_options"]

_HEX: Final = "(?:0[xX])?([0-9A-Fa-f]{1,8})"
_ADAPTER_FILTER: Final = re.compile(f"{_HEX}:{_HEX}")

# What a system call takes for a rate of the line: 31 bits.
_BAUDRATE_MOST: Final = (1 << 31) - 1


def port_arguments() -> argparse.ArgumentParser:
    """Return the arguments that name a port and say how its adapter is set."""
    port = Parser(add_help=False)
    group = port.add_argument_group("the port")
    group.add_argument(
        "-c",
        "--channel",
        metavar="URL",
        required=True,
        help="a device such as /dev/ttyUSB0, or socket://HOST:PORT, rfc2217://HOST:PORT",
    )
    group.add_argument(
        "-p",
        "--protocol",
        type=protocol_name,
        required=True,
        help=f"what the adapter speaks: {', '.join(protocols())}",
    )
    group.add_argument(
        "--baudrate",
        type=whole(least=1, most=_BAUDRATE_MOST),
        help="of the line (default: the protocol's own)",
    )
    for line, what in (("--dtr", "Data Terminal Ready"), ("--rts", "Request To Send")):
        group.add_argument(
            line,
            choices=LEVELS,
            default="leave",
            help=f"the modem line {what} at opening; some boards reset, or do not send, by its "
            "level (default: leave, as the system sets it: on)",
        )
    group.add_argument(
        "--bitrate",
        type=whole(least=1),
        help="of the CAN bus in bit/s: the adapter is set to it where it can be; a load of the "
        "bus is shown by it, without stuff bits",
    )
    group.add_argument(
        "--mode",
        choices=adapters.MODE_NAMES,
        help="of the adapter, with --bitrate (default: normal)",
    )
    group.add_argument(
        "--frame-type",
        choices=adapters.FRAME_TYPES,
        help="frames that the adapter passes on, with --bitrate (default: all)",
    )
    group.add_argument(
        "--adapter-filter",
        metavar="ID:MASK",
        type=_adapter_filter,
        help="frames that the adapter passes on, with --bitrate; hexadecimal, such as 123:7FF "
        "(default: all)",
    )
    group.add_argument(
        "--once",
        action="store_true",
        default=None,
        help="the adapter sends each frame once, acknowledged or not; with --bitrate",
    )
    group.add_argument(
        "--ts-unit",
        choices=TS_UNITS,
        default="ms",
        help="unit of the device's timestamps (default: ms)",
    )
    return port


def duration_arguments() -> argparse.ArgumentParser:
    """Return the arguments of commands that stay at a port."""
    staying = Parser(add_help=False)
    group = staying.add_argument_group("duration and reconnect")
    group.add_argument(
        "--reconnect",
        action="store_true",
        help="when the device is gone wait for it, and go on; the gap is reported",
    )
    group.add_argument(
        "--ping",
        metavar="TIME",
        type=duration,
        help="ping the adapter so often, and search the stream anew when it does not answer",
    )
    group.add_argument(
        "--duration", metavar="TIME", type=duration, help="end after that time, such as 90s, 8h"
    )
    return staying


def port_options(args: argparse.Namespace) -> PortOptions:
    """Return what the arguments ask of a port, as keywords of `canser.open`."""
    return {
        "config": _adapter_config(args),
        "line": LineConfig(
            baudrate=args.baudrate,
            dtr=args.dtr,
            rts=args.rts,
            ping=getattr(args, "ping", None),
        ),
        "ts_unit": args.ts_unit,
        "reconnect": getattr(args, "reconnect", False),
    }


def open_port(args: argparse.Namespace, stop: Stop | None = None) -> Port:
    """Open the port that the arguments name; CallError where that cannot be.

    A signal meanwhile is a KeyboardInterrupt, whether `stop` takes signals or not.
    """
    stop = Stop() if stop is None else stop
    stop.interrupts = True
    if stop:
        raise KeyboardInterrupt
    try:
        return ports.open(args.channel, args.protocol, **port_options(args))
    except (ValueError, PortNotFoundError, PortDeniedError, PortBusyError) as error:
        raise CallError(str(error)) from None
    finally:
        stop.interrupts = False


def _adapter_config(args: argparse.Namespace) -> AdapterConfig | None:
    """Return how the adapter is to be configured; None if it is not to be."""
    filter_id, filter_mask = args.adapter_filter or (None, None)
    options = {
        "bitrate": args.bitrate,
        "mode": args.mode,
        "frame_type": args.frame_type,
        "filter_id": filter_id,
        "filter_mask": filter_mask,
        "once": args.once,
    }
    given = {name: value for name, value in options.items() if value is not None}
    if given.keys() == {"bitrate"} and not protocol(args.protocol).configures:
        return None  # The bitrate of an adapter that takes none is for the load of the bus only.
    return flat_config(given)


def _adapter_filter(text: str) -> tuple[int, int]:
    found = _ADAPTER_FILTER.fullmatch(text)
    if not found:
        raise argparse.ArgumentTypeError(
            f"cannot read the filter {text!r}; write ID:MASK in hexadecimal, such as 123:7FF"
        )
    return int(found[1], 16), int(found[2], 16)
