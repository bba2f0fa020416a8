"""Make the pictures of docs/app.md: a session in the window `hframe app`, in headless Chromium.

    python -m tools.app_pictures [--all FOLDER]

The pictures docs/figures/app_logs.png and docs/figures/app_control.png are parts of the pages that a newcomer
sees. With `--all`, pictures of all stages, on wide and narrow, light and dark displays, are written to a
folder, to be looked at. It needs Chromium, ChromeDriver, selenium and the extra `app`, and takes two minutes.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from PIL import Image

from tests.app.driver import STAGES, Visitor, newcomers_session, served
from tests.browser import SCHEMES, WIDTHS, chromium
from tools.repository import FIGURES

_HEIGHT = 1180  # pixels of a picture of the documentation


def main() -> None:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--all", type=Path, help="folder for pictures of all stages")
    folder = parser.parse_args().all
    with (
        tempfile.TemporaryDirectory() as place,
        served(Path(place) / "my_session") as address,
        chromium() as driver,
    ):
        visitor = Visitor(driver, address)
        newcomers_session(visitor)
        for width in WIDTHS:
            for scheme in SCHEMES:
                visitor.look(width, scheme)
                for number, key in enumerate(STAGES, start=1):
                    if folder is not None:
                        folder.mkdir(parents=True, exist_ok=True)
                        visitor.go(key)
                        visitor.picture(folder / f"{number}_{key}_{width}_{scheme}.png")
        visitor.look(1280, "light")
        for key in ("logs", "control"):
            visitor.go(key)
            path = FIGURES / f"app_{key}.png"
            visitor.picture(path)
            with Image.open(path) as image:
                part = image.crop((0, 0, image.width, min(_HEIGHT, image.height)))
                part.convert("P", palette=Image.Palette.ADAPTIVE).save(path, optimize=True)


if __name__ == "__main__":
    main()
