# SPDX-License-Identifier: Apache-2.0
"""Exported C on other processors (Debian's cross compilers, qemu): equal bit by bit, or up to the C library.

Sine, cosine and exponential of glibc round alike where the processor has fused multiply-adds; without, and in another C
library, they differ in the last bit.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from design.exports.c_program import built, changed, exported
from time_limits import HANG

WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror")
EQUAL = {
    "aarch64-linux-gnu": ((), "qemu-aarch64"),
    "riscv64-linux-gnu": ((), "qemu-riscv64"),
    "s390x-linux-gnu": ((), "qemu-s390x"),  # big-endian
}
"""Options and emulator of processors with fused multiply-adds."""
ROUNDED = {
    "arm-linux-gnueabihf": (("-mfpu=neon",), "qemu-arm"),
    "i686-linux-gnu": (("-msse2", "-mfpmath=sse"), "qemu-i386"),
}
ROUNDING = "-DEFFORT_TOLERANCE=1e-9"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an export with observer, residual, prediction over the delay, gears and limits that act."""
    values = {
        "measurement.velocity": "observer",
        "measurement.gear_ratio": [100.0, -50.0],
        "robust.residual_gain": [20.0, 20.0],
        "robust.delay": 0.001,
        "limits.effort": [0.4, 0.3],
        "on_stop": "gravity_hold",
    }
    return exported(changed("two_link", values), tmp_path_factory.mktemp("export"), samples=2000)


START = r"""
extern void _start(void);
__attribute__((naked)) static void reset(void) { /* enable the floating-point unit */
  __asm volatile("ldr r0, =0xE000ED88\n ldr r1, [r0]\n orr r1, r1, #(0xF << 20)\n str r1, [r0]\n dsb\n isb\n"
                 "ldr r0, =_start\n bx r0\n");
}
__attribute__((section(".vectors"), used)) void (*const vectors[])(void) = {(void (*)(void))0x20400000, reset};
"""
MEMORY = """
MEMORY { code (rx) : ORIGIN = 0x0, LENGTH = 4M
         data (rwx) : ORIGIN = 0x20000000, LENGTH = 4M }
SECTIONS {
  .vectors : { KEEP(*(.vectors)) } > code
  .text : { *(.text*) *(.rodata*) KEEP(*(.init)) KEEP(*(.fini)) KEEP(*(.eh_frame)) } > code
  .ARM.exidx : { __exidx_start = .; *(.ARM.exidx*) __exidx_end = .; } > code
  .init_array : { __preinit_array_start = .; __preinit_array_end = .;
    __init_array_start = .; KEEP(*(.init_array*)) __init_array_end = .;
    __fini_array_start = .; KEEP(*(.fini_array*)) __fini_array_end = .; } > code
  .data : { *(.data*) } > data
  .bss : { __bss_start__ = .; *(.bss*) *(COMMON) __bss_end__ = .; } > data
  end = .; _end = .; __end__ = .;
}
"""


def test_efforts_are_equal_up_to_rounding_on_a_microcontroller_without_operating_system(folder: Path) -> None:
    compiler, emulator = "arm-none-eabi-gcc", "qemu-system-arm"
    _needs(compiler, "gcc-arm-none-eabi libnewlib-arm-none-eabi")
    _needs(emulator, emulator)
    (folder / "board").mkdir()
    start, memory, program = (folder / "board" / name for name in ("start.c", "memory.ld", "replay.elf"))
    start.write_text(START), memory.write_text(MEMORY)
    core = ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard", "--specs=rdimon.specs", f"-T{memory}")
    options = ("-std=c99", "-O2", "-ffp-contract=off", ROUNDING)
    words = [compiler, *core, *options, *map(str, [start, *sorted(folder.glob("*.c"))]), "-o", str(program), "-lm"]
    subprocess.run(words, check=True, capture_output=True, timeout=HANG)
    arguments = f"enable=on,target=native,arg=replay,arg={folder / 'case.txt'}"
    words = [emulator, "-M", "mps2-an500", "-nographic", "-monitor", "none", "-serial", "none"]
    words += ["-semihosting-config", arguments, "-kernel", str(program)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=HANG)
    print(f"\n{compiler}: {done.stdout}{done.stderr}")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2000 samples" in done.stdout + done.stderr


def _needs(program: str, packages: str) -> None:
    if not shutil.which(program):
        pytest.skip(f"{program} is not installed (apt-get install {packages})")


def replayed_on(target: str, options: tuple[str, ...], emulator: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Compile for a processor with warnings as errors, and replay under an emulator."""
    compiler = f"{target}-gcc"
    _needs(compiler, f"gcc-{target}")
    _needs(emulator, "qemu-user")
    command = (compiler, "-std=c99", "-O2", *WARNINGS, "-ffp-contract=off", *options)
    program = built(command, sorted(folder.glob("*.c")), folder / f"replay-{target}")
    words = [emulator, "-L", f"/usr/{target}", str(program), str(folder / "case.txt")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=HANG)
    print(f"\n{compiler} {' '.join(options)}: {done.stdout}")  # figures of docs/tables/processors.md
    return done


@pytest.mark.parametrize("target", EQUAL)
def test_efforts_are_equal_bit_by_bit_on_a_processor_with_fused_multiply_adds(target: str, folder: Path) -> None:
    done = replayed_on(target, *EQUAL[target], folder)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("target", ROUNDED)
def test_efforts_are_equal_up_to_rounding_of_sine_and_cosine_elsewhere(target: str, folder: Path) -> None:
    options, emulator = ROUNDED[target]
    done = replayed_on(target, (*options, ROUNDING), emulator, folder)
    assert done.returncode == 0, done.stdout
