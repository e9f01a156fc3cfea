"""The arguments that name a live port, and the opening of that port."""

import argparse
import re
from typing import Final

from canser import adapters
from canser._protocols import TS_UNITS, protocol, protocols
from canser.adapters import AdapterConfig
from canser.commands._numbers import duration, whole
from canser.commands._parser import CallError, Parser, protocol_name
from canser.commands._stop import Stop
from canser.errors import PortBusyError, PortDeniedError, PortNotFoundError
from canser.live import ports
from canser.live.config import LEVELS, LineConfig, PortOptions, flat_config
from canser.live.ports import Port

__all__ = ["duration_arguments", "open_port", "port_arguments", "port_options"]

_HEX: Final = "(?:0[xX])?([0-9A-Fa-f]{1,8})"
_ADAPTER_FILTER: Final = re.compile(f"{_HEX}:{_HEX}")

# The largest rate that the system calls take: a positive signed integer of 32 bits.
_BAUDRATE_MOST: Final = (1 << 31) - 1


def port_arguments() -> argparse.ArgumentParser:
    """Return the arguments that name a port and configure its adapter."""
    port = Parser(add_help=False)
    group = port.add_argument_group("the port")
    group.add_argument(
        "-c",
        "--channel",
        metavar="URL",
        required=True,
        help="port: a device such as /dev/ttyUSB0 or COM3, socket://HOST:PORT, or "
        "rfc2217://HOST:PORT",
    )
    group.add_argument(
        "-p",
        "--protocol",
        type=protocol_name,
        required=True,
        help=f"protocol of the adapter: {', '.join(protocols())}",
    )
    group.add_argument(
        "--baudrate",
        type=whole(least=1, most=_BAUDRATE_MOST),
        help="rate of the serial line in bit/s (default: that of the adapters of the protocol)",
    )
    for line, what in (("--dtr", "Data Terminal Ready"), ("--rts", "Request To Send")):
        group.add_argument(
            line,
            choices=LEVELS,
            default="leave",
            help=f"level of the modem line {what} when the port is opened; some boards reset, or "
            "do not send, at one of the levels (default: leave; the system sets it on)",
        )
    group.add_argument(
        "--bitrate",
        type=whole(least=1),
        help="bit rate of the CAN bus in bit/s; the adapter is configured to it if the protocol "
        "allows that, and a bus load is computed from it (default: the "
        "adapter is not configured)",
    )
    group.add_argument(
        "--mode",
        choices=adapters.MODE_NAMES,
        help="mode of the adapter; needs --bitrate (default: normal)",
    )
    group.add_argument(
        "--frame-type",
        choices=adapters.FRAME_TYPES,
        help="frames that the adapter passes on; needs --bitrate (default: all)",
    )
    group.add_argument(
        "--adapter-filter",
        metavar="ID:MASK",
        type=_adapter_filter,
        help="the adapter passes on frames whose id equals ID in the bits of MASK, both in "
        "hexadecimal, such as 123:7FF; needs --bitrate (default: all frames)",
    )
    group.add_argument(
        "--once",
        action="store_true",
        default=None,
        help="let the adapter send each frame once, even if it is not acknowledged; needs "
        "--bitrate (default: it repeats such a frame)",
    )
    group.add_argument(
        "--ts-unit",
        choices=TS_UNITS,
        default="ms",
        help="unit of the timestamps of the device (default: ms)",
    )
    return port


def duration_arguments() -> argparse.ArgumentParser:
    """Return the arguments of commands that read a port for a long time."""
    lasting = Parser(add_help=False)
    group = lasting.add_argument_group("duration and reconnect")
    group.add_argument(
        "--reconnect",
        action="store_true",
        help="wait for a device that is gone, and go on when it is back; the gap is reported "
        "(default: end)",
    )
    group.add_argument(
        "--ping",
        metavar="TIME",
        type=duration,
        help="send a ping to the adapter at this interval, such as 1s; without an answer, search "
        "the stream for the next packet anew (default: no pings)",
    )
    group.add_argument(
        "--duration",
        metavar="TIME",
        type=duration,
        help="end after this time, such as 90s or 8h (default: no limit)",
    )
    return lasting


def port_options(args: argparse.Namespace) -> PortOptions:
    """Return the keywords of `canser.open` that the arguments mean."""
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
    """Open the port that the arguments name; CallError if that is not possible.

    A signal during the opening raises KeyboardInterrupt, even if `stop` takes signals.
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
    """Return the configuration of the adapter; None to leave the adapter as it is."""
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
        return None  # The adapter cannot be configured; its bit rate is for the bus load only.
    return flat_config(given)


def _adapter_filter(text: str) -> tuple[int, int]:
    found = _ADAPTER_FILTER.fullmatch(text)
    if not found:
        raise argparse.ArgumentTypeError(
            f"cannot read the filter {text!r}; write ID:MASK in hexadecimal, such as 123:7FF"
        )
    return int(found[1], 16), int(found[2], 16)
