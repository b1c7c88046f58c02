"""An image with what was detected in it; detection runs in the background, so that no click waits for it."""

import asyncio
import logging

from trame.app import asynchronous
from trame.widgets import html

from workbench.app.data.images import overlay_of
from workbench.app.figures import sensor
from workbench.app.ui.base import Tab, points_of, raw
from workbench.core.errors import InputError

_log = logging.getLogger(__name__)


class ImagePanel:
    """A status line and a figure in a tab. `name`: of the figure and of the status line."""

    def __init__(self, tab: Tab, name: str):
        self.tab, self.name = tab, name
        self._shown: tuple | None = None

    def build(self, height: str, click=None) -> None:
        """Make the widgets. click: method of the tab for clicks into the image."""
        self.tab.state[f"{self.name}_text"] = ""
        html.Div(
            "{{ " + self.name + "_text }}",
            **raw(data_text=self.name, role="status"),
        )
        events = {"click": (self.tab.page.handler(click), points_of())} if click else {}
        self.tab.figure(self.name, "Image with detected corners and stripe", height, **events)

    def show(self, index: int) -> None:
        """Show the image at a place of images.csv, in the background where it is another one."""
        opened, excluded = self.tab.work.opened, self.tab.work.session.excluded("images")
        key = (opened, index, opened.recording.images[index]["image"] in excluded)
        if key != self._shown:
            self._shown = key
            asynchronous.create_task(self._draw(key))

    async def _draw(self, key: tuple) -> None:
        opened, index, is_excluded = key
        loop = asyncio.get_running_loop()
        state, text = self.tab.state, f"{self.name}_text"
        try:
            shown, residual = await loop.run_in_executor(None, overlay_of, opened, index)
        except InputError as problem:
            with state:
                state[text] = str(problem)
            return
        except Exception:
            _log.exception("image %s cannot be shown", index)
            with state:
                state[text] = "This image cannot be shown; see the terminal"
            return
        if key == self._shown:
            with state:
                self.tab.draw(self.name, sensor.image(shown, residual))
                state[text] = describe(shown, is_excluded)


def describe(shown, is_excluded: bool) -> str:
    """Name, role and what was detected, in one line."""
    parts = [f"{shown.name}, {shown.role}"]
    if shown.corners.shape[1]:
        parts.append(f"{shown.corners.shape[1]} corners detected")
    if shown.stripe.shape[1]:
        parts.append("laser stripe detected")
    if shown.why:
        parts.append(shown.why)
    if is_excluded:
        parts.append("excluded from the calibration")
    return "; ".join(parts)
