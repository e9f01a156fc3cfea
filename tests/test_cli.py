"""The command as its users run it: files, pipes, signals, terminals, exit codes."""

import os
import select
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import canser
from calls import BAD_CALL, BAD_DATA, GOOD, PATIENCE, assert_fails, command, environment, names, run
from canser.commands import COMMANDS
from canser.recording.header import RecordingInfo
from canser.recording.writer import RecordingWriter
from canser.simulation.traffic import line_noise, vehicle
from reference import WIRE_FORMATS

PROTOCOLS = canser.protocols()
INFO = RecordingInfo("seeed", 2_000_000, None, "ms", "x")
STATUS = bytes.fromhex("AA55 04 01 02") + bytes(14) + b"\x07"

posix = pytest.mark.skipif(
    sys.platform == "win32", reason="signals, named pipes and terminals are POSIX"
)


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two seconds of traffic in each protocol; nothing writes into it."""
    folder = tmp_path_factory.mktemp("captures")
    for protocol in PROTOCOLS:
        frames = vehicle(2, extended=WIRE_FORMATS[protocol].has_ext)
        (folder / f"{protocol}.bin").write_bytes(canser.encode(frames, protocol))
    noise = np.random.default_rng(1).integers(0, 256, 5_000, dtype=np.uint8)
    (folder / "noise.bin").write_bytes(noise.tobytes())
    (folder / "text.txt").write_text("This is a letter and not a capture.\n" * 100)
    (folder / "empty.bin").write_bytes(b"")
    (folder / "folder.bin").mkdir()
    (folder / "there.log").write_text("old")
    (folder / "link.log").symlink_to("there.log")
    (folder / "log.txt").write_text("(1.000000) can0 123#11\n" * 9)
    (folder / "run.txt").write_text("***BUSMASTER Ver 2.4.0***\n***PROTOCOL CAN***\n")
    with RecordingWriter(folder / "run.pcapng", INFO) as writer:
        writer.write((folder / "seeed.bin").read_bytes(), 10**18)
    (folder / "same.pcapng").hardlink_to(folder / "run.pcapng")
    return folder


def test_version(captures: Path) -> None:
    done = run(captures, "--version")
    assert (done.returncode, done.stderr) == (GOOD, b"")
    assert done.stdout.decode().startswith("canser 0.")


@pytest.mark.parametrize("arguments", [[], *([name] for name in COMMANDS)], ids=" ".join)
def test_help_has_examples_and_fits_80_columns(captures: Path, arguments: list[str]) -> None:
    done = run(captures, *arguments, "--help", COLUMNS="80")
    assert (done.returncode, done.stderr) == (GOOD, b"")
    lines = done.stdout.decode().splitlines()
    examples = lines[lines.index("examples:") + 1 :]
    assert examples[0].startswith(f"  canser {' '.join(arguments) or 'info'}")
    assert max(map(len, lines)) <= 80


def test_without_a_command_the_help_is_shown_and_it_is_no_success(captures: Path) -> None:
    done = run(captures, COLUMNS="80")
    assert (done.returncode, done.stderr) == (BAD_CALL, b"")
    assert done.stdout == run(captures, "--help", COLUMNS="80").stdout


def test_raw_bytes_to_a_log_say_what_became_of_every_byte(captures: Path, tmp_path: Path) -> None:
    raw = (captures / "seeed.bin").read_bytes()
    (tmp_path / "run.bin").write_bytes(b"\0" + STATUS + raw + STATUS + b"\0\0")
    count = f"{len(vehicle(2)):,}"
    done = run(tmp_path, "convert", "run.bin", "run.log", "-p", "seeed")
    assert (done.returncode, done.stdout) == (GOOD, b"")
    assert done.stderr.decode().splitlines() == [
        f"run.bin -> run.log: {count} frames",
        f"{len(raw) + 43:,} bytes = {len(raw):,} framed + 40 control + 3 skipped + 0 pending",
        "skipped: marker 3; resyncs: 2",
        "control packets, not in the output as they are no frames: 2",
        f"frames without a time, written as 0: {count}",
    ]
    assert len((tmp_path / "run.log").read_text().splitlines()) == len(vehicle(2))
    assert names(tmp_path) == ["run.bin", "run.log"]


def test_a_log_to_raw_bytes_and_back(captures: Path, tmp_path: Path) -> None:
    source = str(captures / "serial.bin")
    assert run(tmp_path, "convert", source, "a.npy", "-p", "serial").returncode == GOOD
    done = run(tmp_path, "convert", "a.npy", "b.bin", "-p", "python-can")
    raw = (captures / "serial.bin").read_bytes()
    assert (tmp_path / "b.bin").read_bytes() == raw
    count = len(vehicle(2))
    assert done.stderr.decode().splitlines() == [
        f"a.npy -> b.bin: {count:,} frames",
        f"{count:,} frames = {len(raw):,} bytes out",
    ]


def test_force_replaces_what_is_there(captures: Path, tmp_path: Path) -> None:
    (tmp_path / "run.log").write_text("old")
    source = str(captures / "seeed.bin")
    assert run(tmp_path, "convert", source, "run.log", "-p", "seeed", "--force").returncode == GOOD
    assert (tmp_path / "run.log").read_text().startswith("(")


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_info_without_a_protocol_finds_it(captures: Path, protocol: str) -> None:
    done = run(captures, "info", f"{protocol}.bin")
    assert (done.returncode, done.stderr) == (GOOD, b"")
    text = done.stdout.decode()
    assert f"\nprotocol   {protocol}, which explains " in text
    assert f"\nframes     {len(vehicle(2)):,}" in text
    assert "skipped + 0 pending" in text


def test_info_says_that_it_looked_at_a_sample(tmp_path: Path) -> None:
    (tmp_path / "long.bin").write_bytes(canser.encode(vehicle(20), "serial"))
    size = (tmp_path / "long.bin").stat().st_size
    done = run(tmp_path, "info", "long.bin")
    assert f"\ncounted in a sample of 262,144 of {size:,} bytes\n\n" in done.stdout.decode()


def test_info_of_frames_needs_no_protocol(captures: Path, tmp_path: Path) -> None:
    run(tmp_path, "convert", str(captures / "serial.bin"), "run.csv", "-p", "serial")
    done = run(tmp_path, "info", "run.csv")
    assert (done.returncode, done.stderr) == (GOOD, b"")
    assert done.stdout.decode().startswith(f"frames     {len(vehicle(2)):,}")
    assert "bytes" not in done.stdout.decode()


def test_dump_prints_the_frames_that_pass_any_filter(captures: Path) -> None:
    done = run(
        captures, "dump", "serial.bin", "-p", "serial", "--filter", "7E0:7FF", "--filter", "0:600"
    )
    assert (done.returncode, done.stderr) == (GOOD, b"")
    frames = vehicle(2)
    passed = frames[canser.match(frames, "7E0:7FF", "0:600")]
    ids = [line.split()[2].partition(b"#")[0] for line in done.stdout.splitlines()]
    assert [int(one, 16) for one in ids] == passed["id"].tolist()
    assert done.stdout.splitlines()[0].startswith(b"(0.0")


ERRORS = {
    **{
        f"{name} of nothing": ([name], BAD_CALL, ["required", f"see canser {name} --help"])
        for name in COMMANDS
        if name != "ports"  # needs no arguments
    },
    "unknown command": (["decode", "x"], BAD_CALL, ["decode", "convert", "--help"]),
    "missing file": (["info", "missing.bin"], BAD_CALL, ["missing.bin", "No such file"]),
    "missing file to convert": (
        ["convert", "missing.bin", "x.log", "-p", "seeed"],
        BAD_CALL,
        ["missing.bin", "No such file"],
    ),
    "folder": (["info", "folder.bin"], BAD_CALL, ["folder.bin", "directory"]),
    "folder to dump": (["dump", "folder.bin", "-p", "seeed"], BAD_CALL, ["folder.bin", "direct"]),
    "unknown protocol": (
        ["info", "seeed.bin", "-p", "seed"],
        BAD_CALL,
        ["'seed'", "cantalope, seeed, serial", "--help"],
    ),
    "no protocol": (
        ["dump", "seeed.bin"],
        BAD_CALL,
        ["seeed.bin: these bytes look like seeed (100%)", "give -p seeed or -p auto"],
    ),
    "auto for raw bytes": (
        ["convert", "there.log", "x.bin", "-p", "auto"],
        BAD_CALL,
        ["-p", "cantalope, seeed, serial"],
    ),
    "no protocol to encode in": (
        ["convert", "there.log", "x.bin"],
        BAD_CALL,
        ["-p", "cantalope, seeed, serial"],
    ),
    "no protocol of the standard input": (
        ["info", "-"],
        BAD_CALL,
        ["standard input", "-p", "file"],
    ),
    "unknown suffix": (
        ["convert", "seeed.bin", "x.sqlite", "-p", "seeed"],
        BAD_CALL,
        ["x.sqlite", ".blf, .log, .csv, .gvret.csv, .mf4, .npy, .parquet, .pcap, .trc", "--to"],
    ),
    "unknown format": (
        ["convert", "seeed.bin", "x", "-p", "seeed", "--to", "sqlite"],
        BAD_CALL,
        ["sqlite", "npy"],
    ),
    "unknown unit": (
        ["info", "serial.bin", "-p", "serial", "--ts-unit", "minutes"],
        BAD_CALL,
        ["minutes", "ms"],
    ),
    "raw to raw": (
        ["convert", "seeed.bin", "x.bin", "-p", "seeed"],
        BAD_CALL,
        ["both raw", ".log"],
    ),
    "output is there": (
        ["convert", "seeed.bin", "there.log", "-p", "seeed"],
        BAD_CALL,
        ["there.log", "--force"],
    ),
    "output is a folder": (
        ["convert", "seeed.bin", "folder.bin", "-p", "seeed", "--to", "candump", "--force"],
        BAD_CALL,
        ["folder.bin", "directory"],
    ),
    "output in no folder": (
        ["convert", "seeed.bin", "missing/x.log", "-p", "seeed"],
        BAD_CALL,
        ["missing/x.log", "No such file"],
    ),
    "bad filter": (
        ["dump", "seeed.bin", "-p", "seeed", "--filter", "12G"],
        BAD_CALL,
        ["'12G'", "ID:MASK", "123:7FF"],
    ),
    "filter of half an id": (
        ["dump", "seeed.bin", "-p", "seeed", "--filter", "18FE"],
        BAD_CALL,
        ["'18FE' has 4 digits", "write 000018FE, or ID:MASK"],
    ),
    "empty file": (["info", "empty.bin"], BAD_DATA, ["empty.bin", "empty"]),
    "text": (["info", "text.txt"], BAD_DATA, ["text.txt is a text, not raw bytes"]),
    "auto of noise": (["dump", "noise.bin", "-p", "auto"], BAD_CALL, ["look like no protocol"]),
    "a log that is to be raw bytes": (
        ["info", "log.txt", "-p", "seeed"],
        BAD_CALL,
        ["log.txt is a candump log, not raw bytes", "leave -p out"],
    ),
    "a BUSMASTER log": (["info", "run.txt"], BAD_DATA, ["BUSMASTER", "converts it to ASC"]),
    "noise": (["info", "noise.bin"], BAD_DATA, ["noise.bin", "no protocol fits", "-p"]),
    "the wrong protocol": (
        ["convert", "serial.bin", "x.log", "-p", "seeed"],
        BAD_DATA,
        [
            "of the 67,355 bytes are in no seeed packet",
            "look like serial (100%)",
            "--as-is accepts",
        ],
    ),
    "raw bytes of another protocol as a text": (
        ["convert", "text.txt", "x.log", "-p", "serial"],
        BAD_DATA,
        ["text.txt is a text, not raw bytes"],
    ),
    "a recording in another protocol": (
        ["info", "run.pcapng", "-p", "serial"],
        BAD_CALL,
        ["run.pcapng is a recording in seeed, not in serial", "--as-is"],
    ),
    "the file itself": (
        ["convert", "there.log", "there.log", "--to", "csv", "--force"],
        BAD_CALL,
        ["there.log and there.log are one file"],
    ),
    "a link to the file itself": (
        ["convert", "link.log", "there.log", "--to", "csv", "--force"],
        BAD_CALL,
        ["there.log and link.log are one file"],
    ),
    "a hard link to the recording itself": (
        ["recover", "run.pcapng", "same.pcapng", "--force"],
        BAD_CALL,
        ["same.pcapng and run.pcapng are one file"],
    ),
    "protocol in capitals": (
        ["convert", "serial.bin", "x.log", "-p", "SEEED"],
        BAD_DATA,
        ["in no seeed packet"],
    ),
    "raw bytes as a log": (
        ["info", "seeed.bin", "--from", "candump"],
        BAD_DATA,
        ["seeed.bin, line 1: ", "raw bytes?"],
    ),
    "bad line": (["convert", "there.log", "x.npy"], BAD_DATA, ["there.log, line 1: 'old'"]),
    "text as an array": (["info", "text.txt", "--from", "npy"], BAD_DATA, ["text.txt: no .npy"]),
}


@pytest.mark.parametrize("name", ERRORS)
def test_an_error_is_one_line_that_names_the_remedy(captures: Path, name: str) -> None:
    if sys.platform == "win32" and "folder" in name:
        pytest.skip("Windows opens no folder and calls that a permission that is denied")
    arguments, code, words = ERRORS[name]
    before = names(captures)
    assert_fails(run(captures, *arguments), code, *words)
    assert names(captures) == before
    assert (captures / "there.log").read_text() == "old"


@pytest.mark.parametrize("command", ["info", "dump"])
def test_the_wrong_protocol_is_printed_and_refused(captures: Path, command: str) -> None:
    (captures / "wrong.bin").write_bytes(
        (captures / "serial.bin").read_bytes() + 2 * canser.encode(vehicle(0.01), "seeed")
    )
    done = run(captures, command, "wrong.bin", "-p", "seeed")
    assert done.returncode == BAD_DATA
    assert done.stdout
    last = done.stderr.decode().splitlines()[-1]
    assert "in no seeed packet; they look like serial (9" in last
    assert last.endswith("; --as-is accepts them")
    accepted = run(captures, command, "wrong.bin", "-p", "seeed", "--as-is")
    assert accepted.returncode == GOOD
    assert accepted.stdout == done.stdout
    (captures / "wrong.bin").unlink()


def test_bytes_are_accepted_as_they_are(captures: Path, tmp_path: Path) -> None:
    target = str(tmp_path / "x.log")
    done = run(captures, "convert", "serial.bin", target, "-p", "seeed", "--as-is")
    assert done.returncode == GOOD
    assert (tmp_path / "x.log").exists()
    done = run(captures, "info", "run.pcapng", "-p", "serial", "--as-is")
    assert done.returncode == GOOD
    assert b"frames     0" in done.stdout


def test_auto_reads_the_protocol_that_fits_and_says_which(captures: Path) -> None:
    for name in PROTOCOLS:
        done = run(captures, "dump", f"{name}.bin", "-p", "auto")
        assert done.returncode == GOOD
        assert done.stdout == run(captures, "dump", f"{name}.bin", "-p", name).stdout
        assert f"{name}.bin: read as {name} (".encode() in done.stderr


def test_a_file_on_the_standard_input_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "run.bin"
    path.write_bytes(canser.encode(vehicle(1), "seeed"))
    before = path.read_bytes()
    call = command("convert", "-", "run.bin", "-p", "seeed", "--to", "candump", "--force")
    with path.open("rb") as file:
        done = subprocess.run(call, cwd=tmp_path, stdin=file, capture_output=True, check=False)
    assert_fails(done, BAD_CALL, "run.bin and - are one file")
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "arguments",
    [
        ["convert", "run.log", "run.npy"],
        ["convert", "run.log", "run.bin", "-p", "serial"],
        ["info", "run.log"],
    ],
    ids=" ".join,
)
def test_two_buses_that_become_one_are_told(tmp_path: Path, arguments: list[str]) -> None:
    text = "(1.0) can0 123#11 R\n(2.0) can1 123#22 T\n(3.0) can0 123#33 R\n"
    (tmp_path / "run.log").write_text(text)
    done = run(tmp_path, *arguments)
    assert done.returncode == GOOD
    said = done.stderr.decode()
    assert "frames of 2 channels become one: can0 2, can1 1\n" in said
    assert "direction is not kept: received 2, sent 1\n" in said
    (tmp_path / "run.log").write_text(text.replace("can1", "can0").replace("T", "R"))
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain" / "run.log").write_bytes((tmp_path / "run.log").read_bytes())
    said = run(tmp_path / "plain", *arguments).stderr.decode()
    assert "become one" not in said
    assert "direction" not in said


def test_dump_and_a_log_keep_channels_and_directions(tmp_path: Path) -> None:
    text = "(1.000000) can0 123#11\n(2.000000) can1 123#22 T\n(3.000000) vcan0 123#33\n"
    (tmp_path / "run.log").write_text(text)
    done = run(tmp_path, "dump", "run.log")
    assert (done.stdout.decode(), done.stderr) == (text, b"")
    done = run(tmp_path, "dump", "run.log", "--start", "1s", "--count", "1")
    assert done.stdout.decode().splitlines() == text.splitlines()[1:2]
    assert run(tmp_path, "convert", "run.log", "same.log").returncode == GOOD
    assert (tmp_path / "same.log").read_text() == text


def test_strict_names_a_frame_that_cannot_be_encoded(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", vehicle(1))
    done = run(tmp_path, "convert", "x.npy", "x.bin", "-p", "cantalope", "--strict")
    first = int(np.flatnonzero(vehicle(1)["ext"])[0])
    assert_fails(done, BAD_DATA, f"{first}", "extended")
    assert names(tmp_path) == ["x.npy"]


def test_frames_that_cannot_be_encoded_are_left_out_and_counted(tmp_path: Path) -> None:
    frames = vehicle(1)
    np.save(tmp_path / "x.npy", frames)
    done = run(tmp_path, "convert", "x.npy", "x.bin", "-p", "cantalope")
    standard = frames[~frames["ext"]]
    extended = f"{len(frames) - len(standard):,}"
    assert done.returncode == GOOD
    said = done.stderr.decode().splitlines()
    assert said[0] == f"x.npy -> x.bin: {len(standard):,} frames"
    assert f"{extended} frames left out: extended ids {extended}" in said
    assert (tmp_path / "x.bin").read_bytes() == canser.encode(standard.copy(), "cantalope")


@pytest.mark.parametrize("arguments", [["info"], ["dump", "-p", "seeed"]], ids=" ".join)
def test_a_file_that_may_not_be_read_is_named(tmp_path: Path, arguments: list[str]) -> None:
    path = tmp_path / "x.bin"
    path.write_bytes(STATUS)
    path.chmod(0)
    prefix = []
    if os.access(path, os.R_OK):
        if not shutil.which("setpriv"):
            pytest.skip("everything may be read: by the superuser, and on Windows")
        # The superuser without the right to override permissions.
        prefix = ["setpriv", "--bounding-set", "-dac_override,-dac_read_search"]
    done = subprocess.run(
        [*prefix, *command(*arguments, "x.bin")],
        cwd=tmp_path,
        capture_output=True,
        env=environment(),
        timeout=PATIENCE,
        check=False,
    )
    assert_fails(done, BAD_CALL, "x.bin", "Permission denied")


def test_pipes_in_and_out(captures: Path) -> None:
    raw = (captures / "serial.bin").read_bytes()
    log = run(captures, "convert", "-", "-", "-p", "serial", stdin=raw)
    assert log.returncode == GOOD
    assert log.stdout.startswith(b"(0.0")
    assert log.stdout.count(b"\n") == len(vehicle(2))
    back = run(captures, "convert", "-", "-", "-p", "serial", "--from", "candump", stdin=log.stdout)
    assert back.returncode == GOOD
    assert back.stdout == raw
    info = run(captures, "info", "-", "-p", "serial", stdin=raw)
    assert info.returncode == GOOD
    assert info.stdout.startswith(b"frames ")


def test_an_array_comes_out_of_a_pipe_whole(captures: Path, tmp_path: Path) -> None:
    done = run(captures, "convert", "serial.bin", "-", "-p", "serial", "--to", "npy")
    (tmp_path / "x.npy").write_bytes(done.stdout)
    assert np.load(tmp_path / "x.npy").tobytes() == vehicle(2).tobytes()


def test_a_file_as_the_standard_input_is_read(captures: Path) -> None:
    with (captures / "seeed.bin").open("rb") as file:
        done = subprocess.run(
            command("dump", "-", "-p", "seeed"),
            stdin=file,
            capture_output=True,
            env=environment(),
            timeout=PATIENCE,
            check=False,
        )
    assert (done.returncode, done.stderr) == (GOOD, b"")
    assert done.stdout.count(b"\n") == len(vehicle(2))


@posix
def test_frames_of_a_live_stream_are_printed_as_they_come() -> None:
    with subprocess.Popen(
        command("dump", "-", "-p", "seeed"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment(),
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for id_ in (b"\x23\x01", b"\x24\x01"):
            process.stdin.write(b"\xaa\xc1" + id_ + b"\xab\x55")
            process.stdin.flush()
            ready, _, _ = select.select([process.stdout], [], [], PATIENCE)
            assert ready, "no frame came although one went in"
            digits = id_[::-1].hex()[1:].encode()
            assert process.stdout.readline().rstrip().endswith(b"can0 " + digits + b"#AB")
        process.stdin.close()
        assert process.wait(PATIENCE) == GOOD


@posix
@pytest.mark.parametrize(
    "arguments",
    [["dump", "run.bin", "-p", "serial"], ["convert", "run.bin", "-", "-p", "serial"]],
    ids=["dump", "convert"],
)
def test_a_reader_that_has_enough_is_no_error(tmp_path: Path, arguments: list[str]) -> None:
    """As in `canser dump ... | head -1`."""
    # More than a pipe holds.
    (tmp_path / "run.bin").write_bytes(canser.encode(vehicle(20), "serial"))
    with subprocess.Popen(
        command(*arguments),
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment(),
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline().startswith(b"(0.0")
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(PATIENCE) == GOOD


@pytest.mark.parametrize("unbuffered", ["", "1"], ids=["buffered", "unbuffered"])
@pytest.mark.parametrize("name", ["info", "dump"])
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_a_disk_that_is_full_is_an_error(name: str, unbuffered: str) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            # One frame: less than a buffer holds.
            command(name, "-", "-p", "seeed"),
            input=b"\xaa\xc0\x23\x01\x55",
            stdout=full,
            stderr=subprocess.PIPE,
            env=environment(PYTHONUNBUFFERED=unbuffered),
            timeout=PATIENCE,
            check=False,
        )
    assert_fails(done, BAD_DATA, "No space left on device")


def shell(
    folder: Path, before: str, *arguments: str, after: str = "", **more: str
) -> subprocess.CompletedProcess[bytes]:
    """Run the command by a shell that does something before."""
    return subprocess.run(
        ["sh", "-c", f'{before} exec "$@" {after}', "sh", *command(*arguments)],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env=environment(**more),
        timeout=PATIENCE,
        check=False,
    )


@posix
@pytest.mark.parametrize("unbuffered", ["", "1"], ids=["buffered", "unbuffered"])
def test_a_disk_that_runs_full_does_not_cut_the_output_in_silence(
    captures: Path, tmp_path: Path, unbuffered: str
) -> None:
    """A write may take a part of the bytes only; the rest must not be forgotten."""
    done = shell(
        captures,
        "ulimit -f 8;",
        *("convert", "seeed.bin", "-", "-p", "seeed"),
        after=f"> {tmp_path / 'x.log'}",
        PYTHONUNBUFFERED=unbuffered,
        PYTHONDONTWRITEBYTECODE="1",
    )
    assert_fails(done, BAD_DATA, "File too large")


@posix
@pytest.mark.parametrize(
    ("closed", "arguments"),
    [
        ("<&-", ["dump", "-", "-p", "seeed"]),
        (">&-", ["dump", "seeed.bin", "-p", "seeed"]),
        (">&-", ["info", "seeed.bin", "-p", "seeed"]),
    ],
)
def test_a_stream_that_is_closed_is_an_error_of_one_line(
    captures: Path, closed: str, arguments: list[str]
) -> None:
    done = shell(captures, "", *arguments, after=closed)
    assert_fails(done, BAD_CALL, "standard")


@posix
def test_a_named_pipe_is_not_called_empty(tmp_path: Path) -> None:
    """As in `canser info <(zcat run.bin.gz)`: it can be read only once."""
    os.mkfifo(tmp_path / "fifo")
    thread = threading.Thread(target=(tmp_path / "fifo").write_bytes, args=(STATUS,))
    thread.start()
    assert_fails(run(tmp_path, "info", "fifo"), BAD_CALL, "fifo", "only once", "-p")
    thread.join()


@posix
@pytest.mark.parametrize(
    ("number", "code"),
    [
        pytest.param(number, code, id=number.name)
        for number, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143))
    ]
    + ([pytest.param(signal.SIGHUP, 129, id="SIGHUP")] if sys.platform != "win32" else []),
)
def test_a_signal_leaves_no_half_file(tmp_path: Path, number: signal.Signals, code: int) -> None:
    with subprocess.Popen(
        command("convert", "-", "x.log", "-p", "serial"),
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        process.stdin.write(canser.encode(vehicle(2), "serial"))
        process.stdin.flush()
        end = time.monotonic() + PATIENCE
        while not names(tmp_path) and time.monotonic() < end:
            time.sleep(0.01)
        assert names(tmp_path) not in ([], ["x.log"]), "the file is not under way"
        process.send_signal(number)
        assert process.wait(PATIENCE) == code
        assert len(process.stderr.read().splitlines()) <= 1
    assert names(tmp_path) == []


# What a terminal shows: bars of rich's, or a plain line where rich is not installed.
PLAIN = 'import sys; sys.modules["rich"] = None'
RICH = "import sys"
AT_ONCE = """
import canser._progress
canser._progress._PATIENCE_S = 0
from canser.commands.cli import main
sys.exit(main(sys.argv[1:]))
"""


LONG_NAME = "a-capture-with-a-name-as-test-stands-give-them-" + "0123456789" * 5 + ".bin"


@pytest.fixture
def long_capture(tmp_path: Path) -> Path:
    """Return a folder with a capture of three blocks, of which each moves the bar."""
    (tmp_path / "run.bin").write_bytes(canser.encode(vehicle(1), "seeed") * 80)
    (tmp_path / LONG_NAME).hardlink_to(tmp_path / "run.bin")
    return tmp_path


def on_terminal(folder: Path, code: str, *arguments: str) -> tuple[int, bytes]:
    """Run Python with 80 columns as its standard error; return what they show, as sent."""
    import fcntl  # noqa: PLC0415 - not on Windows
    import pty  # noqa: PLC0415
    import termios  # noqa: PLC0415

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    with subprocess.Popen(
        [sys.executable, "-c", code + AT_ONCE, *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=theirs,
        env=environment(),
    ) as process:
        os.close(theirs)
        shown = b"".join(until_closed(ours))
        os.close(ours)
        return process.wait(PATIENCE), shown


def until_closed(terminal: int) -> Iterator[bytes]:
    while True:
        try:
            data = os.read(terminal, 1 << 16)
        except OSError:  # Linux: the other side is closed
            return
        if not data:  # macOS
            return
        yield data


@posix
def test_a_terminal_shows_a_plain_line_and_wipes_it(long_capture: Path) -> None:
    code, shown = on_terminal(long_capture, PLAIN, "convert", "run.bin", "x.npy", "-p", "seeed")
    assert code == GOOD
    line, _, rest = shown.rpartition(b"\r\x1b[K")
    assert line.count(b"\rconverting run.bin: ") == 3
    assert line.endswith(b": 100 %")
    assert rest.startswith(b"run.bin -> x.npy: ")


@posix
def test_a_terminal_shows_the_bar_of_rich_and_wipes_it(long_capture: Path) -> None:
    pytest.importorskip("rich")
    code, shown = on_terminal(long_capture, RICH, "convert", "run.bin", "x.npy", "-p", "seeed")
    assert code == GOOD
    bar, _, rest = shown.rpartition(b"\x1b[2K")
    assert b"converting run.bin" in bar
    assert b"MB" in bar
    assert rest.startswith(b"run.bin -> x.npy: ")


@posix
def test_a_plain_line_with_a_long_name_fits_the_terminal(long_capture: Path) -> None:
    """A line that wraps is not wiped: each step would leave another one behind."""
    _, shown = on_terminal(long_capture, PLAIN, "info", LONG_NAME, "-p", "seeed")
    steps = shown.split(b"\r")[1:]
    assert max(map(len, steps)) < 80
    assert b"100 %" in shown


@posix
def test_a_bar_of_rich_with_a_long_name_shows_how_far_it_is(long_capture: Path) -> None:
    pytest.importorskip("rich")
    _, shown = on_terminal(long_capture, RICH, "info", LONG_NAME, "-p", "seeed")
    assert b"MB" in shown


@pytest.mark.parametrize("code", [PLAIN, RICH], ids=["plain", "rich"])
def test_a_pipe_gets_no_progress(long_capture: Path, code: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", code + AT_ONCE, "info", "run.bin", "-p", "seeed"],
        cwd=long_capture,
        capture_output=True,
        env=environment(),
        timeout=PATIENCE,
        check=False,
    )
    assert (done.returncode, done.stderr) == (GOOD, b"")
    assert b"\r" not in done.stdout.replace(b"\r\n", b"\n")


def test_noise_is_no_error(tmp_path: Path) -> None:
    raw = line_noise(canser.encode(vehicle(2), "serial"), rate=1e-2)
    (tmp_path / "run.bin").write_bytes(raw)
    done = run(tmp_path, "info", "run.bin")
    assert (done.returncode, done.stderr) == (GOOD, b"")
    assert "skipped    " in done.stdout.decode()
