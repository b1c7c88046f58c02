"""Balls as a sensor sees them, with noise of known kind: for the tests of the fit and of the search."""

import numpy as np


def cap(n: int, half: float, radius: float) -> np.ndarray:
    """(3, n) points spread evenly over the cap that faces -z, of half angle `half` (rad): a golden spiral."""
    height = 1 - (np.arange(n) + 0.5) / n * (1 - np.cos(half))
    turn = np.arange(n) * np.pi * (3 - np.sqrt(5))
    across = np.sqrt(1 - height**2)
    return radius * np.stack([across * np.cos(turn), across * np.sin(turn), -height])


def ray_cast(shapes: list, width: int, height: int, focal: float) -> np.ndarray:
    """(3, height, width) mm where the rays of a pinhole camera at the origin hit Open3D meshes; nan where none."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    for shape in shapes:
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(shape))
    u, v = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    rays = np.stack([u / focal, v / focal, np.ones_like(u)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays = np.concatenate([np.zeros_like(rays), rays], axis=-1).astype(np.float32)
    depth = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy().astype(float)
    depth[~np.isfinite(depth)] = np.nan
    return np.moveaxis(rays[..., 3:].astype(float) * depth[..., None], -1, 0)


def along_rays(points: np.ndarray, sigma: float, random: np.random.Generator) -> np.ndarray:
    """The same points with noise along the rays from the origin."""
    length = np.sqrt((points**2).sum(0))
    return points * (1 + random.normal(0, sigma, length.shape) / length)


def ball(centre, radius: float, resolution: int = 200):
    """A tessellated ball; its vertices lie on it, its faces inside."""
    import open3d as o3d

    return o3d.geometry.TriangleMesh.create_sphere(radius, resolution).translate(centre)


def block(centre, size):
    """A box about its middle."""
    import open3d as o3d

    return o3d.geometry.TriangleMesh.create_box(*size).translate(
        np.subtract(centre, np.divide(size, 2))
    )


def post(centre, radius: float, length: float, lying: bool = False):
    """A round post along z, or along y where it lies."""
    import open3d as o3d

    made = o3d.geometry.TriangleMesh.create_cylinder(radius, length, 100)
    if lying:
        made.rotate(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))
    return made.translate(centre)


def pixel_error(
    points: np.ndarray, planes: np.ndarray, focal: float, along: str = "rows"
) -> np.ndarray:
    """(3, n) mm by which points (3, n) in the camera frame move when the stripe's centre errs by 1 px.

    `planes` (4, n) light plane of each point; `focal` px; `along` "rows" where centres are sought
    along the rows of the image, "columns" else. The ray turns in the image and still ends in the light plane:
    the error lies in the plane. Its direction is `direction` of `fit_ball`, its length times the
    centre's sigma (px) is `sigma`.
    """
    depth, flat = points[2], points / points[2]
    turned = np.zeros_like(points)
    turned[0 if along == "rows" else 1] = 1 / focal
    slope = (planes[:3] * turned).sum(0) / (planes[:3] * flat).sum(0)
    return depth * (turned - slope * flat)
