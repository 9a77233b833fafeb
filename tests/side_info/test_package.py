"""Who reads scenarios needs no service."""

import subprocess
import sys


def test_the_service_is_not_imported_with_the_package() -> None:
    code = "import sys, side_info; sys.exit('side_info.service.service' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
