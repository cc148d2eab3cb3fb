"""A fitted film as one PyVista picture: people in the world on the left, what each camera sees on the right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..models.normals import vertex_normals
from ..models.suit import suit_of
from .motion_state import MotionState
from .motion_views import ViewPictures
from .overlay import Overlay
from .plotted import PANEL, Box, Look, Plotted, controls_beside, halves
from .skin import suit_colours

_COLUMN, _STRIP = 360, 110  # [px] of the controls
_SHARE, _LESS = 0.6, 0.45  # of the space that the people in 3D have, and on the first screen
_LETTER = 12  # [px]
_SKIN = {"interpolation": "Gouraud", "ambient": 0.3, "diffuse": 0.75, "specular": 0.0}
_PAINT = "colour"  # name of the colours in a person's surface
_GRID, _CAMERAS = "#b9bec6", "#70767e"
_MOST_LINES = 40  # of the ground, each way
_AROUND = 0.5  # [m] of ground beside the people
_CAMERA_DEPTH = 0.4  # [m] of a camera's pyramid
_FROM, _ANGLE = (0.45, 0.3, 1.0), 30.0  # direction from which all is seen at first, and the angle of view [degrees]
_FILLED = 0.6  # of the half diagonal of the people's space


class PlottedMotion(Plotted):
    """A plotter with people, the ground, cameras, and the views' pictures; ``films``: of each view."""

    def __init__(
        self,
        state: MotionState,
        films: Sequence[Path | None],
        *,
        off_screen: bool = True,
        smooth: bool = True,
    ) -> None:
        super().__init__(["solid", "pictures"], off_screen=off_screen, smooth=smooth)
        self.state = state
        self.ground, self.cameras = True, True  # whether they are shown
        self._open("solid")
        self.people = {
            person: self._add(self._skin(person), scalars=_PAINT, rgb=True, name=f"person{person}", **_SKIN)
            for person in state.people
        }
        self._grid = self._add(self._lines(_ground(state.room.low, state.room.high)), color=_GRID, line_width=1)
        pyramids = np.concatenate([self._pyramid(index) for index in range(len(state.saved.views))])
        self._pyramids = self._add(self._lines(pyramids), color=_CAMERAS, line_width=1.5)
        self._painted = Overlay(self.view("pictures"))
        self.pictures = ViewPictures(state, self._painted, films)
        self.arrange(self.look_now)
        self.look()
        self.update()

    def _places(self, look: Look) -> Mapping[str, Box]:
        picture, panel = controls_beside(look, _COLUMN, _STRIP)
        solid, pictures = halves(picture, _SHARE if look.more else _LESS)
        return {"solid": solid, "pictures": pictures, PANEL: panel}

    def _arranged(self, boxes: Mapping[str, Box]) -> None:
        width, height = self.body_view.GetSize()
        half = np.tan(np.deg2rad(_ANGLE / 2)) / min(1.0, width / max(height, 1))  # in a narrow view, too, all is seen
        self.body_view.camera.view_angle = 2 * np.rad2deg(np.arctan(half))
        box = boxes["pictures"]
        if (box.width, box.height) != self._painted.size:
            self._painted.begin((box.width, box.height), _LETTER * self.look_now.zoom)
            self.pictures.arrange((box.width, box.height))
            self.pictures.update()

    def _skin(self, person: int) -> object:
        model = self.state.saved.motions[person].model
        points = model.rest_vertices.cpu().numpy().astype(np.float32)
        shown = self._pv.PolyData.from_regular_faces(points, model.faces.cpu().numpy())
        shown.point_data[_PAINT] = suit_colours(model, self.state.colour(person))
        return shown

    def _lines(self, ends: np.ndarray) -> object:
        """Lines between pairs of points (N, 2, 3)."""
        count = len(ends)
        places = np.c_[np.full(count, 2), np.arange(2 * count).reshape(count, 2)]
        return self._pv.PolyData(ends.reshape(-1, 3), lines=places.ravel())

    def _pyramid(self, index: int) -> np.ndarray:
        """Lines from a camera to the corners of what it sees, and around them, shape (8, 2, 3)."""
        view = self.state.saved.views[index]
        focal, centre = (each[0].double().numpy() for each in (view.view.camera.focal, view.view.camera.centre))
        height, width = view.size
        corners = (np.array([(0, 0), (width, 0), (width, height), (0, height)]) - centre) / focal
        seen = _CAMERA_DEPTH * np.c_[corners, np.ones(4)]
        turn, move = view.view.rotation.double().numpy(), view.view.translation.double().numpy()
        eye, ends = ((points - move) @ turn @ self.state.room.turn.T for points in (np.zeros(3), seen))
        return np.concatenate([[(eye, end) for end in ends], np.stack([ends, np.roll(ends, -1, axis=0)], axis=1)])

    def look(self) -> None:
        """See all in 3D as at first: from the first camera's side."""
        low, high = self.state.room.low, self.state.room.high
        middle, camera = (low + high) / 2, self.body_view.camera
        away = _FILLED * np.linalg.norm(high - low) / np.sin(np.deg2rad(_ANGLE / 2))
        camera.position = tuple(middle + away * np.array(_FROM) / np.linalg.norm(_FROM))
        camera.focal_point, camera.up = tuple(middle), (0.0, 1.0, 0.0)
        self.body_view.ResetCameraClippingRange()

    def update(self) -> None:
        """Bring everything to what the state is now; nothing is drawn yet."""
        bodies = self.state.bodies()
        for person, actor in self.people.items():
            actor.visibility = person in bodies
            if person in bodies:
                skin, model = actor.mapper.dataset, self.state.saved.motions[person].model
                worn = suit_of(model).put_on(bodies[person].vertices[0]).numpy()
                skin.points = (worn @ self.state.room.turn.T).astype(np.float32)
                skin.point_data.active_normals = vertex_normals(skin.points, model.faces.cpu().numpy())
        self._grid.visibility, self._pyramids.visibility = self.ground, self.cameras
        self.pictures.update()
        self.body_view.ResetCameraClippingRange()

    def said(self) -> list[str]:
        """Frame and time that are shown, and how many people are there; a film that can't be read."""
        state = self.state
        there = f"{len(state.bodies())} of {len(state.people)} people"
        lines = [f"frame {state.frame} of {state.count} · {state.saved.times[state.frame]:.2f} s · {there}"]
        return [*lines, self.pictures.fault] if self.pictures.fault else lines


def _ground(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Lines of a square grid at the lowest y, a metre or more apart, shape (N, 2, 3)."""
    begin, end = np.floor(low - _AROUND), np.ceil(high + _AROUND)
    step = max(np.ceil((end - begin)[[0, 2]].max() / _MOST_LINES), 1.0)
    end = begin + step * np.ceil((end - begin) / step)
    lines = []
    for along, across in ((0, 2), (2, 0)):
        for position in np.arange(begin[across], end[across] + step / 2, step):
            ends = np.full((2, 3), low[1])
            ends[:, across], ends[:, along] = position, (begin[along], end[along])
            lines.append(ends)
    return np.array(lines)
