"""Moments of weighted points and of images, whose magnitudes stay where the scene is turned.

    points, centres ──► windowed ──► zernike, hu ──► log_features

`zernike` looks at a disc about the origin, `hu` at all points about their centroid; `soft_zernike`
and `soft_inside` fade towards the edge of the disc, for gradients.
"""

from jaxtrack.moments.features import log_features, soft_log_features
from jaxtrack.moments.hu import hu
from jaxtrack.moments.image import hu_image, image_points, zernike_image
from jaxtrack.moments.window import Windows, cloud_windows, inside, soft_inside, windowed
from jaxtrack.moments.zernike import LOW_ORDERS, PAPER_ORDERS, Orders, soft_zernike, zernike

__all__ = [
    "LOW_ORDERS",
    "PAPER_ORDERS",
    "Orders",
    "Windows",
    "cloud_windows",
    "hu",
    "hu_image",
    "image_points",
    "inside",
    "log_features",
    "soft_inside",
    "soft_log_features",
    "soft_zernike",
    "windowed",
    "zernike",
    "zernike_image",
]
