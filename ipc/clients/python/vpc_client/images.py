"""Images: NumPy arrays over shared memory, at both ends. NumPy is needed for `array` and `publish` only."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

import iceoryx2 as iox2

from .errors import BadArgument, BadMessage
from .messages import SERVICES, Encoding, ImageHeader
from .ports import Port, PublishingPort, Sent, check, now_ns, unsigned

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

SERVICE = "vpc/image"
# Bytes of a pixel, by its encoding.
BYTES_PER_PIXEL = {Encoding.MONO8: 1, Encoding.BGR8: 3, Encoding.RGB8: 3, Encoding.YUYV: 2}
# Most bytes of an image that a publisher can be opened for.
MOST_BYTES = 4 * 8192 * 8192


def bytes_of(header: ImageHeader) -> int:
    """Bytes of the image that a header describes; raises BadMessage where it describes none."""
    check(SERVICE, header, sequenced=False)
    row = header.width * BYTES_PER_PIXEL[Encoding(header.encoding)]
    if header.stride < row:
        raise BadMessage(f"{SERVICE}: stride = {header.stride}; allowed: {row} or more")
    return int(header.stride * header.height)


def check_image(header: ImageHeader, size: int) -> None:
    """Raises BadMessage where a header is not that of an image of so many bytes, or contradicts itself."""
    check(SERVICE, header)
    if (expected := bytes_of(header)) != size:
        raise BadMessage(f"{SERVICE}: bytes = {size}; allowed: {expected}")
    begin, end = header.exposure_begin_ns, header.exposure_begin_ns + header.exposure_ns
    if begin and not begin <= header.stamp.data_ns <= end:
        raise BadMessage(f"{SERVICE}: data_ns = {header.stamp.data_ns}; allowed: {begin} to {end}")


class _Pixels:
    """The bytes of an image in shared memory."""

    def __init__(self, header: ImageHeader, sample: Any, *owners: Any) -> None:
        self.header = header
        self._bytes = (ctypes.c_uint8 * sample.payload().len()).from_address(sample.payload_ptr)
        # Every array is a view of these bytes, and so keeps the memory where it is.
        self._bytes._owners = (sample, *owners)

    def __len__(self) -> int:
        return len(self._bytes)

    def _array(self, view: memoryview) -> npt.NDArray[np.uint8]:
        import numpy as np

        header, pixel = self.header, BYTES_PER_PIXEL[Encoding(self.header.encoding)]
        shape: tuple[int, ...] = (header.height, header.width, pixel)
        strides: tuple[int, ...] = (header.stride, pixel, 1)
        if pixel == 1:
            shape, strides = shape[:2], strides[:2]
        return np.ndarray(shape, np.uint8, view, 0, strides)


class Image(_Pixels):
    """A received image that passed its checks. Its memory is borrowed until it and all of its arrays are gone."""

    @property
    def data(self) -> memoryview:
        """All bytes, read-only, without a copy."""
        return memoryview(self._bytes).cast("B").toreadonly()

    @property
    def array(self) -> npt.NDArray[np.uint8]:
        """The image as a read-only array without a copy: (height, width) in mono8, (height, width, 3) in bgr8 and rgb8,
        (height, width, 2) in yuyv."""
        return self._array(self.data)


class LoanedImage(_Pixels):
    """Shared memory for an image that is not sent yet: fill in `array`, and the times of `header`."""

    def __init__(self, header: ImageHeader, sample: Any, port: Any) -> None:
        super().__init__(header, sample, port)
        self._sample: Any = sample

    @property
    def array(self) -> npt.NDArray[np.uint8]:
        """The image to be filled in, shaped as `Image.array`. Do not write to it after the image is sent."""
        return self._array(memoryview(self._bytes).cast("B"))


class ImagePublisher(PublishingPort):
    """The publisher of images."""

    def __init__(self, port: Any, place: int, most: int) -> None:
        super().__init__(SERVICE, port, place)
        self._most = most

    def loan(self, width: int, height: int, encoding: Encoding = Encoding.MONO8, stride: int = 0) -> LoanedImage:
        """Memory for an image, rows without a gap or `stride` bytes apart. One image may be loaned at a time."""
        header = ImageHeader()
        header.width, header.height = unsigned("width", width, 8192), unsigned("height", height, 8192)
        header.encoding = unsigned("encoding", encoding, len(Encoding) - 1)
        header.stride = unsigned("stride", stride) or width * BYTES_PER_PIXEL[Encoding(header.encoding)]
        if (size := bytes_of(header)) > self._most:
            raise BadArgument(
                f"{SERVICE}: an image of {size} bytes; allowed: {self._most}, for which the port was opened"
            )
        try:
            sample = self._port.loan_slice_uninit(size)
        except iox2.LoanError as error:
            raise BadArgument(f"{SERVICE}: no memory for an image: {error}; allowed: one image at a time") from error
        return LoanedImage(header, sample, self._port)

    def send(self, image: LoanedImage) -> Sent:
        """Sends a loaned image under the next sequence number.

        `published_ns` 0 becomes the present time, and `data_ns` 0 becomes `published_ns`; other values stand."""
        if image._sample is None:
            raise BadArgument(f"{SERVICE}: this image was sent; allowed: one send of each loan")
        header = image.header
        header.stamp.sequence = self.sequence + 1
        header.stamp.published_ns = header.stamp.published_ns or now_ns()
        header.stamp.data_ns = header.stamp.data_ns or header.stamp.published_ns
        check_image(header, len(image))
        sample, image._sample = image._sample, None
        ctypes.memmove(sample.user_header_ptr, ctypes.byref(header), ctypes.sizeof(header))
        sample.assume_init().send()
        self.sequence += 1
        return Sent(header.stamp.sequence, header.stamp.published_ns)

    def publish(
        self,
        pixels: npt.NDArray[np.uint8],
        encoding: Encoding | None = None,
        data_ns: int = 0,
        exposure_begin_ns: int = 0,
        exposure_ns: int = 0,
        published_ns: int = 0,
    ) -> Sent:
        """Publishes an array of bytes: (height, width) as mono8, (height, width, 3) as bgr8, (height, width, 2) as yuyv,
        unless `encoding` says otherwise. It is copied once, into shared memory.

        `data_ns` is the middle of the exposure [as published]; its begin and length are 0 where they are unknown."""
        shape: tuple[int, ...] = getattr(pixels, "shape", ())
        depth = shape[2] if len(shape) == 3 else 1 if len(shape) == 2 else 0
        chosen = {1: Encoding.MONO8, 2: Encoding.YUYV, 3: Encoding.BGR8}.get(depth) if encoding is None else encoding
        if chosen is None or BYTES_PER_PIXEL[chosen] != depth or pixels.dtype != "uint8":
            kind = getattr(pixels, "dtype", type(pixels).__name__)
            raise BadMessage(
                f"{SERVICE}: {kind} of shape {shape}; allowed: uint8, shape (height, width), (height, width, 3) or (height,"
                " width, 2), as the encoding has it"
            )
        image = self.loan(shape[1], shape[0], chosen)
        image.header.stamp.data_ns = unsigned("data_ns", data_ns)
        image.header.stamp.published_ns = unsigned("published_ns", published_ns)
        image.header.exposure_begin_ns = unsigned("exposure_begin_ns", exposure_begin_ns)
        image.header.exposure_ns = unsigned("exposure_ns", exposure_ns)
        image.array[...] = pixels
        return self.send(image)

    def skip(self) -> None:
        """Skips a sequence number: a frame that the camera took and lost."""
        self.sequence += 1

    def _delete(self) -> None:
        """Ends the port with the last array of an image that it loaned."""


class ImageSubscriber(Port):
    """Receives images."""

    def latest(self) -> Image | None:
        """The newest image since the last call, without a copy; None where there is none. Hold one other image at most.

        Raises BadMessage where it breaks the contract; the next one may be good."""
        newest = None
        for _ in range(SERVICES[SERVICE].buffer + 1):
            try:
                sample = self._port.receive()
            except iox2.ReceiveError as error:
                raise BadArgument(
                    f"{SERVICE}: no image can be received: {error}; allowed: one held besides the newest, arrays count"
                ) from error
            if sample is None:
                break
            newest = sample
        if newest is None:
            return None
        header = ImageHeader.from_buffer_copy(newest.user_header().contents)
        check_image(header, newest.payload().len())
        return Image(header, newest)
