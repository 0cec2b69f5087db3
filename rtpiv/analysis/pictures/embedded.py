"""Pictures small enough to stand in a page: grey or tinted, encoded as an address that is the picture itself."""

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

WIDEST_PX = 1008  # the full frames are files beside the page
GAMMA = 0.6  # particles are few and small: shown as recorded, a reduced picture of them is black


def grey(frame: NDArray[Any], limits: tuple[float, float]) -> NDArray[np.uint8]:
    """8-bit picture of a frame between two grey levels, brightened for the eye; NaN is the darker one."""
    low, high = limits
    scaled = (np.nan_to_num(frame.astype(np.float32), nan=low) - low) / max(high - low, 1e-9)
    return np.asarray(255.0 * np.clip(scaled, 0.0, 1.0) ** GAMMA, dtype=np.uint8)


def tinted(picture: NDArray[np.uint8], colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """RGB picture of a grey one (H, W): where `colours` (H, W, 3) is not black, that."""
    covered = colours.any(axis=-1)
    rgb = np.repeat(picture[..., None], 3, axis=-1)
    rgb[covered] = colours[covered]
    return rgb


def reduced(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture that is at most WIDEST_PX wide; what is left out is averaged."""
    import cv2

    height, width = image.shape[:2]
    if width <= WIDEST_PX:
        return image
    size = (WIDEST_PX, max(1, round(height * WIDEST_PX / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def embedded(image: NDArray[np.uint8]) -> str:
    """Data address of a picture, grey (H, W) or RGB (H, W, 3), reduced to WIDEST_PX."""
    import cv2

    image = reduced(image)
    if image.ndim == 3:
        image = np.ascontiguousarray(image[..., ::-1])
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()
