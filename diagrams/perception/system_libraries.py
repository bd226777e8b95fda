"""System libraries that Drake and OpenCV load, and the Debian packages that provide them.

Wheels contain nearly everything; what they leave to the system shows only when an import fails, one library
at a time.
"""

import re

IMPORTS = ("pydrake.all", "cv2")

DEBIAN_PACKAGES = {
    "libglib-2.0.so.0": "libglib2.0-0",
    "libgthread-2.0.so.0": "libglib2.0-0",
    "libpcre2-8.so.0": "libpcre2-8-0",
    "libz.so.1": "zlib1g",
    "libstdc++.so.6": "libstdc++6",
    "libgcc_s.so.1": "libgcc-s1",
    "libgomp.so.1": "libgomp1",
    "libX11.so.6": "libx11-6",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libOpenGL.so.0": "libopengl0",
}
"""Debian and Ubuntu package of each shared library that versions of Drake and OpenCV require."""

RENDER = "from slipmap.diagrams.perception.renderer import render_one_picture; render_one_picture()"

RENDERING_PACKAGES = ("libegl1", "libgl1-mesa-dri", "libglib2.0-0")
"""Packages that Drake's camera needs, beyond those of the imports, to render without a display."""


def package_for(failure: str) -> str | None:
    """Debian package of the shared library that a loader error reports as missing, if both are known."""
    return DEBIAN_PACKAGES.get(missing_library(failure) or "")


def missing_library(failure: str) -> str | None:
    """The shared library that a loader error reports as missing, if it is such an error."""
    match = re.search(r"(lib[\w.+-]+\.so[\d.]*): cannot open shared object file", failure)
    return match.group(1) if match else None
