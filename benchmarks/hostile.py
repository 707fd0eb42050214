"""Hostile recordings: what `greygate look FILE` does with files that were made to harm whoever opens them.

Each file is made and looked at in a fresh folder. What is counted: code that ran (a file appears), foreign bytes (a
number of a secret file is printed or written), hangs (10 s of computing, or a minute of waiting), the most memory of
all processes together, and tracebacks.
"""

import gzip
import json
import os
import struct
import subprocess
import time
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import h5py
import numpy as np
from scipy.io import savemat

from .made import keep
from .shared import GREYGATE, scratch

TAKES = "five minutes"
HANGS, WAITS = 10.0, 60.0  # s of computing, s in all
MOST = 1 << 30  # bytes of memory
SECRET = 31337.25  # the number in the secret file
PRINTED = ("31337.25", "31,337", "31337")
T = np.arange(100) * 1e-3
FILES: dict[str, Callable[[Path], None]] = {}


def file(name: str, **arguments: object) -> Callable:
    """Register what writes the file of that name."""

    def registered(write: Callable) -> Callable:
        FILES[name] = partial(write, **arguments)
        return write

    return registered


# -- text ------------------------------------------------------------------------------------------------------------

TEXTS = {
    "formula.csv": "t_s,x_m\n0,=cmd|'/c touch ran'!A1\n1,2\n",
    "expression.csv": "t_s,x_m\n0,__import__('os').system('touch ran')\n1,2\n",
    "header.csv": "t [s],x [__import__('os').system('touch ran')]\n0,1\n1,2\n",
    "columns.csv": ",".join(f"c{k}_m" for k in range(50_000)) + "\n" + ",".join(["0"] * 50_000) + "\n",
    "same.csv": ",".join(["x_m"] * 50_000) + "\n" + ",".join(["0"] * 50_000) + "\n",
    "line.csv": "t_s,x_m\n" + "9" * 5_000_000 + ",1\n1,2\n",
    "quotes.csv": 't_s,x_m\n"' + "a\n" * 500_000,
    "nul.csv": "t_s,x_m\n" + "\0" * 1_000_000,
}
for name, text in TEXTS.items():
    FILES[name] = lambda path, text=text: path.write_text(text)


@file("bomb.csv.gz")
def zipped(path: Path) -> None:
    path.write_bytes(gzip.compress(b"t_s,x_m\n" + b"0,0\n" * 100_000_000, 9))


# -- MATLAB 5 --------------------------------------------------------------------------------------------------------


@file("zeros.mat")
def zeros(path: Path) -> None:
    savemat(path, {"t": np.zeros(60_000_000)}, do_compression=True)


@file("struct.mat")
def struct_of_zeros(path: Path) -> None:
    savemat(path, {"s": {"a": {"t": np.zeros(60_000_000)}}}, do_compression=True)


@file("cells.mat")
def cells(path: Path) -> None:
    savemat(path, {"c": np.full((400_000,), 1.0).astype(object)}, do_compression=True)


@file("names.mat")
def names(path: Path) -> None:
    savemat(path, {f"v{k}": k for k in range(30_000)})


@file("nested.mat")
def nested(path: Path) -> None:
    value: object = 1.0
    for _ in range(150):
        value = {"a": value}
    savemat(path, {"s": value})


@file("text.mat")
def long_text(path: Path) -> None:
    savemat(path, {"s": "a" * 50_000_000, "t": T}, do_compression=True)


def raw_mat(path: Path, shape: tuple[int, int], kind: int = 6, data: bytes = b"") -> None:
    """A variable whose header says what it is not."""
    flags = struct.pack("<IIII", 6, 8, kind, 0)
    dims = struct.pack("<IIii", 5, 8, *shape)
    body = flags + dims + struct.pack("<HH4s", 1, 1, b"x") + struct.pack("<II", 9, len(data)) + data
    packed = zlib.compress(struct.pack("<II", 14, len(body)) + body)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
    path.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)


FILES["huge.mat"] = partial(raw_mat, shape=(2**31 - 1, 2**31 - 1))
FILES["negative.mat"] = partial(raw_mat, shape=(-1, 2**31 - 1))
FILES["hugecell.mat"] = partial(raw_mat, shape=(2**31 - 1, 1), kind=1)

# -- HDF5 and MATLAB 7.3 ---------------------------------------------------------------------------------------------


def secret(path: Path) -> Path:
    return path.parent / "secret.h5"


def external(inside: h5py.File, path: Path) -> None:
    inside.create_dataset("x_m", (100,), "f8", external=[(str(secret(path)), 2048, 800)])


def linked(inside: h5py.File, path: Path) -> None:
    inside["x_m"] = h5py.ExternalLink(str(secret(path)), "x")


def softly(inside: h5py.File, path: Path) -> None:
    inside["d/out"] = h5py.ExternalLink(str(secret(path)), "/")
    inside["x_m"] = h5py.SoftLink("/d/out/x")


def virtual(inside: h5py.File, path: Path) -> None:
    layout = h5py.VirtualLayout((100,), "f8")
    layout[:] = h5py.VirtualSource(str(secret(path)), "x", (100,))
    inside.create_virtual_dataset("x_m", layout)


def referred(inside: h5py.File, path: Path) -> None:
    external(inside.create_group("#refs#"), path)
    cell = inside.create_dataset("x_m", (1, 1), h5py.ref_dtype)
    cell[0, 0] = inside["#refs#/x_m"].ref
    cell.attrs["MATLAB_class"] = np.bytes_("cell")


def circular(inside: h5py.File, path: Path) -> None:
    group = inside.create_group("g")
    for k in range(10):
        group[f"g{k}"] = group


def endless(inside: h5py.File, path: Path) -> None:
    inside.create_dataset("x_m", (10**13,), "f8", chunks=(1000,))


def packed(inside: h5py.File, path: Path) -> None:
    inside.create_dataset("x_m", data=np.zeros(60_000_000), compression="gzip", chunks=(1_000_000,))


def many(inside: h5py.File, path: Path) -> None:
    for k in range(25_000):
        inside.create_group(f"g{k}")


def plugin(inside: h5py.File, path: Path) -> None:
    inside.create_dataset("x_m", data=T, chunks=(100,), compression="gzip")
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_chunk((100,))
    plan.set_filter(31337, h5py.h5z.FLAG_OPTIONAL, (1,))
    h5py.h5d.create(inside.id, b"y_m", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple((100,)), plan)


def scaled(inside: h5py.File, path: Path) -> None:
    inside["x_m"] = T
    inside["x_m"].attrs["scale_factor"] = "__import__('os').system('touch ran')"


INSIDE = (external, linked, softly, virtual, referred, circular, endless, packed, many, plugin, scaled)


def hdf5(path: Path, fill: Callable[[h5py.File, Path], None]) -> None:
    with h5py.File(secret(path), "w") as inside:
        inside["x"] = np.full(1000, SECRET)
    with h5py.File(path, "w", userblock_size=512) as inside:
        inside["t"] = T
        fill(inside, path)
    if path.suffix == ".mat":
        with path.open("r+b") as block:
            block.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


for fill in INSIDE:
    FILES[f"{fill.__name__}.h5"] = partial(hdf5, fill=fill)
    if fill not in (scaled, plugin, many):
        FILES[f"{fill.__name__}_73.mat"] = partial(hdf5, fill=fill)

# -- MDF -------------------------------------------------------------------------------------------------------------

RUN = "__import__('os').system('touch ran')"
FORMULAS = (f"X1+{RUN}", f"(lambda:{RUN})()", f"().__class__.__base__.__subclasses__()[0].__init__.__globals__[{RUN}]")


def mdf(path: Path, formula: str, version: str) -> None:
    from asammdf import MDF, Signal

    room = "1" * 200
    with MDF(version=version) as made:
        made.append([Signal(T, T, name="u", unit="V", conversion={"formula": room})])
        data = made.save(path.with_suffix(".mf4" if version > "4" else ".mdf"), overwrite=True).read_bytes()
    at = data.rindex(room.encode())
    path.write_bytes(data[:at] + formula.encode().ljust(len(room)) + data[at + len(room) :])


for k, formula in enumerate(FORMULAS):
    FILES[f"formula{k}.mf4"] = partial(mdf, formula=formula, version="4.10")
    FILES[f"formula{k}.dat"] = partial(mdf, formula=formula, version="3.30")
FILES["powers.mf4"] = partial(mdf, formula="9**9**9**9**9**9**9", version="4.10")


@file("same.mf4")
def same(path: Path) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as made:
        made.append([Signal(T[:3], T[:3], name="u", unit="V") for _ in range(10_000)])
        made.save(path)


@file("attached.mf4")
def attached(path: Path) -> None:
    from asammdf import MDF, Signal

    secret(path).write_text(f"{SECRET}\n" * 1000)
    with MDF(version="4.10") as made:
        made.append([Signal(T, T, name="u", unit="V")])
        made.attach(b"x", file_name=str(secret(path)), embedded=False, mime="text/plain")
        made.save(path)


@file("comment.mf4")
def comment(path: Path) -> None:
    from asammdf import MDF, Signal

    bomb = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12))
    head = f'<?xml version="1.0"?><!DOCTYPE CNcomment [<!ENTITY a0 "aaaaaaaaaa">{bomb}]>'
    text = f"{head}<CNcomment><TX>&a11;</TX></CNcomment>"
    with MDF(version="4.10") as made:
        made.append([Signal(T, T, name="u", unit="V", comment=text)])
        made.save(path)


# -- Parquet, TDMS, MCAP ---------------------------------------------------------------------------------------------


def parquet(path: Path, columns: dict, **options: object) -> None:
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table(columns), path, **options)


FILES["zeros.parquet"] = lambda path: parquet(path, {"t_s": np.zeros(40_000_000)})
FILES["packed.parquet"] = lambda path: parquet(
    path, {"t_s": np.zeros(40_000_000)}, compression="gzip", use_dictionary=False
)
FILES["columns.parquet"] = lambda path: parquet(path, {f"c{k}_m": T[:3] for k in range(21_000)})
FILES["text.parquet"] = lambda path: parquet(path, {"t": T, "s_m": ["a" * 1_000_000] * 100})


@file("rows.parquet")
def rows(path: Path) -> None:
    """The number of rows that the file tells is 2^62."""
    parquet(path, {"t_s": T[:64]})
    data = path.read_bytes()
    path.write_bytes(data.replace(b"\x16\x80\x01\x19", b"\x16" + b"\x80" * 8 + b"\x40\x19"))


@file("huge.tdms")
def huge_tdms(path: Path) -> None:
    tdms(path)
    data = path.read_bytes()
    path.write_bytes(data.replace(struct.pack("<Q", 100), struct.pack("<Q", 2**62)))


@file("segments.tdms")
def tdms(path: Path, segments: int = 1) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as writer:
        for _ in range(segments):
            writer.write_segment([ChannelObject("g", "u", T, properties={"wf_increment": 1e-3, "unit_string": "V"})])


FILES["segments.tdms"] = partial(tdms, segments=20_000)


@file("cut.tdms")
def cut(path: Path) -> None:
    tdms(path)
    path.write_bytes(path.read_bytes()[:-500] + b"TDSm" * 100_000)


def mcap(path: Path, messages: list[bytes], compression: str = "NONE") -> None:
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as opened:
        writer = Writer(opened, compression=CompressionType[compression])
        writer.start()
        channel = writer.register_channel("/rig", "json", writer.register_schema("s", "jsonschema", b"{}"))
        for k, message in enumerate(messages):
            writer.add_message(channel, k * 10**6, message, k * 10**6)
        writer.finish()


NAMES = json.dumps({f"c{k}_m": 0 for k in range(200_000)}).encode()
FILES["names.mcap"] = lambda path: mcap(path, [NAMES, NAMES])
FILES["deep.mcap"] = lambda path: mcap(path, [b'{"a":' * 100_000 + b"1" + b"}" * 100_000] * 2)
FILES["zeros.mcap"] = lambda path: mcap(path, [b'{"x_m":0,"s":"' + b"0" * 20_000_000 + b'"}'] * 30, "ZSTD")
FILES["digits.mcap"] = lambda path: mcap(path, [b'{"x_m":' + b"9" * 4000 + b"}"] * 2)
FILES["infinite.mcap"] = lambda path: mcap(path, [b'{"x_m":Infinity}'] * 2)
FILES["long.mcap"] = lambda path: mcap(path, [b'{"' + b"a" * 10_000_000 + b'":1}'] * 2)


# -- what happens ----------------------------------------------------------------------------------------------------


def looked(name: str, write: Callable[[Path], None]) -> dict:
    """What `look` does with one file."""
    with scratch() as place:
        write(place / name)
        size = (place / name).stat().st_size
        begin, used = time.monotonic(), os.times()
        command = [GREYGATE, "look", name, "--out", "out.csv"]
        with (place / "said").open("wb") as said:
            process = subprocess.Popen(command, cwd=place, stdout=said, stderr=said, start_new_session=True)
            most, tops = 0, {}
            while process.poll() is None and time.monotonic() - begin < WAITS:
                now = tree(process.pid)
                tops |= {pid: max(top, tops.get(pid, 0)) for pid, top in now.items()}
                most = max(most, sum(tops[pid] for pid in now))
                time.sleep(0.02)
            hung = process.poll() is None
            if hung:
                process.kill()
            process.wait()
        now = os.times()
        computed = now.children_user - used.children_user + now.children_system - used.children_system
        text = (place / "said").read_text(errors="replace")
        written = text + "".join(p.read_text(errors="replace") for p in place.glob("out.csv"))
        return {
            "bytes": size,
            "code_run": (place / "ran").exists(),
            "foreign_bytes": any(part in written for part in PRINTED),
            "hang": hung or computed > HANGS,
            "memory_MB": most >> 20,
            "traceback": "Traceback" in text,
            "computing_s": round(computed, 1),
            "exit": process.returncode,
            "said": text.strip().replace(str(place), "")[:200],
        }


def tree(root: int) -> dict[int, int]:
    """Process -> the most memory that it had so far, in bytes, of a process and all below it."""
    parents, tops = {}, {}
    for place in Path("/proc").glob("[0-9]*"):
        try:
            told = dict(line.split(":", 1) for line in (place / "status").read_text().splitlines() if ":" in line)
        except OSError:
            continue
        parents[int(place.name)] = int(told["PPid"])
        tops[int(place.name)] = 1024 * int(told.get("VmHWM", "0").split()[0])
    found = {root}
    while more := {pid for pid, parent in parents.items() if parent in found} - found:
        found |= more
    return {pid: tops[pid] for pid in found if pid in tops}


def main(*wanted: Annotated[str, FILES]) -> None:
    found = {}
    for name in wanted or FILES:
        found[name] = looked(name, FILES[name])
        print(f"{name:22}", {k: v for k, v in found[name].items() if k != "bytes"}, flush=True)
    totals = {
        "files": len(found),
        **{k: sum(f[k] for f in found.values()) for k in ("code_run", "foreign_bytes", "hang", "traceback")},
        "over_1_GiB": sum(f["memory_MB"] << 20 >= MOST for f in found.values()),
        "most_memory_MB": max(f["memory_MB"] for f in found.values()),
        "refused": sum(f["exit"] == 2 for f in found.values()),
    }
    print(totals)
    if not wanted:
        keep("hostile", "look", {"totals": totals, "each": found})
