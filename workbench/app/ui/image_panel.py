"""An image with what was detected in it; detection runs in the background, so that no click waits for it."""

import asyncio
import logging

from trame.app import asynchronous
from trame.widgets import html

from workbench.app.data.recorded_images.images import overlay_of
from workbench.app.figures import sensor, style
from workbench.app.ui.attributes import raw
from workbench.app.ui.base import Tab, points_of
from workbench.core.errors import InputError

_log = logging.getLogger(__name__)
_WAITING = "Detecting corners and stripe ..."


class ImagePanel:
    """A status line and a figure in a tab. `name`: of the figure and of the status line."""

    def __init__(self, tab: Tab, name: str):
        self.tab, self.name = tab, name
        self._shown: tuple | None = None
        self._turn = asyncio.Lock()

    def build(self, height: str, click=None, *names: str) -> None:
        """Make the widgets. click: method of the tab for clicks into the image, called with the fields `names`."""
        self.tab.state[f"{self.name}_text"] = ""
        html.Div(
            "{{ " + self.name + "_text }}",
            **raw(data_text=self.name, role="status"),
        )
        events = {"click": (self.tab.page.handler(click), points_of(*names))} if click else {}
        self.tab.figure(self.name, "Image with detected corners and stripe", height, **events)

    def show(self, index: int) -> None:
        """Show the image at a place of images.csv, in the background where it is another one."""
        opened = self.tab.work.opened
        excluded = self.tab.work.session.excluded("images")
        key = (opened, index, opened.recording.images[index]["image"] in excluded)
        if key != self._shown:
            self._shown = key
            self.tab.state[f"{self.name}_text"] = _WAITING
            asynchronous.create_task(self._draw_newest(key))

    async def _draw_newest(self, key: tuple) -> None:
        """Draw one image at a time; images that were passed in the meantime are skipped."""
        async with self._turn:
            if key == self._shown:
                await self._draw(key)

    async def _draw(self, key: tuple) -> None:
        opened, index, is_excluded = key
        try:
            loop = asyncio.get_running_loop()
            shown, residual = await loop.run_in_executor(None, overlay_of, opened, index)
        except InputError as problem:
            self._show_problem(key, str(problem))
        except Exception:
            _log.exception("image %s cannot be shown", index)
            self._show_problem(key, "This image cannot be shown; see the terminal")
        else:
            if key == self._shown:
                with self.tab.state:
                    self.tab.draw(self.name, sensor.image(shown, residual))
                    self.tab.state[f"{self.name}_text"] = describe(shown, is_excluded)

    def _show_problem(self, key: tuple, text: str) -> None:
        """Say why an image is not shown, and remove the image that was shown before it."""
        if key == self._shown:
            with self.tab.state:
                self.tab.draw(self.name, style.plane("x (px)", "y (px)", "image"))
                self.tab.state[f"{self.name}_text"] = text


def describe(shown, is_excluded: bool) -> str:
    """Name, role and what was detected, in one line."""
    phrases = [f"{shown.name}, {shown.role}"]
    if shown.corners.shape[1]:
        phrases.append(f"{shown.corners.shape[1]} corners detected")
    if shown.stripe.shape[1]:
        phrases.append("laser stripe detected")
    if shown.why:
        phrases.append(shown.why)
    if is_excluded:
        phrases.append("excluded from the calibration")
    return "; ".join(phrases)
