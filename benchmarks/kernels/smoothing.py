"""Diffusion and tolerance regions, and their peers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.kernels.scene import TOLERANCE, Band, Scene, diffuse, over_bands
from benchmarks.measure.contest import Call, Case, Contestant, Unsuitable
from tilepipe.engine.options import default_workers
from tilepipe_kernels.image import diffusion
from tilepipe_kernels.regions import growing
from tilepipe_kernels.regions.region_table import region_table

FLOAT = 4


def diffusion_case(scene: Scene, steps: int) -> Case:
    """So many explicit steps on the raw intensity; a step reads the image and its input and writes the image."""
    return Case(
        f"diffusion, {steps} steps",
        "Mpx·steps/s",
        scene.megapixels * steps,
        scene.size**2 * steps * 3 * FLOAT,
        [
            Contestant("tilepipe, curvature", lambda: _ours(scene, steps, "curvature"), ours=True),
            Contestant("tilepipe, Perona–Malik", lambda: _ours(scene, steps, "perona-malik-rational"), ours=True),
            Contestant("OpenCV ximgproc", lambda: _opencv(scene, steps), note="8-bit colour only, 3 channels"),
            Contestant("medpy in dask map_overlap", lambda: _medpy_in_dask(scene, steps)),
            Contestant("medpy", lambda: _medpy(scene, steps), serial=True),
            Contestant("skimage TV (Chambolle)", lambda: _chambolle(scene, steps), serial=True, note="other model"),
        ],
        aim=400,
    )


def _ours(scene: Scene, steps: int, model: diffusion.Model) -> Call:
    image = scene.grey
    halo = diffusion.halo(steps, 1.0, model)

    def run(workers: int) -> Any:
        def band(rows: Band) -> NDArray[np.float32]:
            core = (rows.core.start, rows.core.stop, 0, scene.size)
            if model == "curvature":
                return diffuse(image[rows.padded], steps, core)
            return diffusion.diffuse(
                image[rows.padded], steps=steps, time_step=0.25, conductance=10.0, model=model, core=core
            )

        return over_bands(band, scene.size, halo, workers)

    return run


def _opencv(scene: Scene, steps: int) -> Call:
    import cv2

    colour = np.repeat(scene.grey_bytes[..., None], 3, axis=2)

    def run(workers: int) -> Any:
        cv2.setNumThreads(workers)
        return cv2.ximgproc.anisotropicDiffusion(colour, 0.15, 0.12, steps)

    return run


def _medpy(scene: Scene, steps: int) -> Call:
    from medpy.filter.smoothing import anisotropic_diffusion

    image = scene.grey
    return lambda workers: anisotropic_diffusion(image, niter=steps, kappa=30, gamma=0.15, option=1)


def _medpy_in_dask(scene: Scene, steps: int) -> Call:
    import dask
    import dask.array as da
    from medpy.filter.smoothing import anisotropic_diffusion

    image = da.from_array(scene.grey, chunks=min(1024, scene.size // 2))
    # dask cannot overlap by more than a chunk
    depth = min(steps, image.chunksize[0])
    smooth = image.map_overlap(
        anisotropic_diffusion, depth=depth, boundary="none", dtype=np.float32, meta=np.empty((0, 0), np.float32),
        niter=steps, kappa=30, gamma=0.15, option=1,
    )  # fmt: skip

    def run(workers: int) -> Any:
        with dask.config.set(scheduler="threads", num_workers=workers):
            return smooth.compute()

    return run


def _chambolle(scene: Scene, steps: int) -> Call:
    from skimage.restoration import denoise_tv_chambolle

    image = scene.grey / np.float32(255)
    return lambda workers: denoise_tv_chambolle(image, weight=0.2, eps=0, max_num_iter=steps)


def regions_case(scene: Scene) -> Case:
    """Components of pixels that differ by little from their neighbours, on the diffused intensity."""

    def ours() -> Call:
        image = scene.diffused
        return lambda workers: over_bands(
            lambda rows: growing.grow_regions(image[rows.padded], TOLERANCE), scene.size, 0, workers
        )

    def cc3d() -> Call:
        import cc3d

        image = scene.diffused
        return lambda workers: cc3d.connected_components(image, delta=TOLERANCE, connectivity=4)

    return Case(
        "tolerance regions",
        "Mpx/s",
        scene.megapixels,
        scene.size**2 * 2 * FLOAT,
        [
            Contestant("tilepipe grow_regions", ours, ours=True, note="seams are joined by facts, not timed"),
            Contestant("cc3d delta", cc3d, serial=True),
            Contestant("skimage", _no_tolerance),
        ],
        aim=150,
    )


def _no_tolerance() -> Call:
    raise Unsuitable("its label joins equal values only")


def table_case(scene: Scene) -> Case:
    """Area, box, contour and mean of every region."""

    def ours() -> Call:
        image = scene.diffused
        # every band has its own labels, as a tile has
        labels = {
            workers: over_bands(
                lambda rows: growing.grow_regions(image[rows.padded], TOLERANCE), scene.size, 0, workers
            )
            for workers in (1, default_workers())
        }

        def run(workers: int) -> Any:
            def band(rows: Band) -> Any:
                own = labels[workers][rows.start * workers // scene.size]
                return region_table(own, image[rows.padded], int(own.max()))

            return over_bands(band, scene.size, 0, workers)

        return run

    def cc3d() -> Call:
        import cc3d

        labels = growing.grow_regions(scene.diffused, TOLERANCE).astype(np.uint32)
        return lambda workers: cc3d.statistics(labels)

    def skimage() -> Call:
        from skimage.measure import regionprops_table

        part = slice(0, scene.size // 4)
        labels = growing.grow_regions(scene.diffused[part, part], TOLERANCE)
        image = scene.diffused[part, part]
        wanted = ("area", "bbox", "mean_intensity")
        return lambda workers: regionprops_table(labels, image, properties=wanted)

    return Case(
        "region table",
        "Mpx/s",
        scene.megapixels,
        scene.size**2 * 2 * FLOAT,
        [
            Contestant("tilepipe region_table", ours, ours=True),
            Contestant("cc3d statistics", cc3d, serial=True, note="no contour, no mean"),
            Contestant("skimage regionprops_table", skimage, serial=True, share=1 / 16, note="no contour; a 16th"),
        ],
    )
