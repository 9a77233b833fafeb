"""The browser of tests: the system's Chromium, driven by Playwright, which brings none that can be had everywhere."""

import shutil
from typing import Final

#: Where it is; None if it is not installed.
CHROMIUM: Final = shutil.which("chromium") or shutil.which("chromium-browser")
#: WebGL by software, for machines without a GPU.
ARGUMENTS: Final = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
