"""Layouts of the framing `binary` by chance, and streams of their frames: whole, damaged, cut, between garbage."""

from micromanip_drivers.line.binary_options import Binary

CRCS = ("crc8.maxim_dow", "crc16.modbus", "crc16.ibm_3740", "crc32.iso_hdlc", "xor8", "sum8", "lrc8", "sum16")
UNSIGNED = ("uint8", "uint16", "uint24", "uint32", "uint64")
TYPES = (*UNSIGNED, "int8", "int16", "int24", "int32", "int64", "float32", "float64")
SIZES = {name: {"float32": 4, "float64": 8}.get(name) or int(name.lstrip("uint")) // 8 for name in TYPES}


class Layout:
    """One framing: two messages that are received, where they can be told apart, and one that is sent."""

    def __init__(self, draw):
        self.draw, self.end = draw, draw.randint(1, 3)
        self.sync = bytes(draw.randint(0x80, 0xFF) for _ in range(self.end))
        self.kind = self.number(("uint8", "uint16")) if draw.random() < 0.7 else None
        self.length = self.number(("uint8", "uint16")) | {"plus": draw.randint(-3, 5)} if draw.random() < 0.6 else None
        crc = draw.choice((*CRCS, None))
        self.crc = None if crc is None else {"name": crc, "first": draw.randint(0, 2), "byte_order": self.order()}
        header = self.end
        received = {}
        for k in range(2 if self.kind else 1):
            self.end = header
            received[f"in{k}"] = self.message(f"in{k}", k + 1, {})
            if draw.random() < 0.6:
                received[f"in{k}"]["counter"] = self.number(("uint8", "uint8", "uint16", "uint64"))
            if draw.random() < 0.6:
                received[f"in{k}"]["status"] = self.number(("uint8", "uint32")) | {"good": (0, 5), "mask": 0x0F}
        self.end = header
        sent = self.message("out", 9, {"safe": 0.0}, 8) | {"cyclic_safe": True}
        if draw.random() < 0.6:
            sent["counter"] = self.number(("uint8", "uint16"))
        self.options = Binary.model_validate(
            {
                "sync": self.sync.hex(),
                "kind": self.kind,
                "length": self.length,
                "crc": self.crc,
                "receive": received,
                "send": {"out": sent},
            }
        )
        self.counts = dict.fromkeys(received, 0)

    def order(self):
        return self.draw.choice(("little", "big"))

    def number(self, types=TYPES):
        """A number behind those before, with a byte between them now and then."""
        kind = self.draw.choice(types)
        at = self.end + (self.draw.random() < 0.2)
        self.end = at + SIZES[kind]
        return {"at": at, "type": kind, "byte_order": self.order()}

    def message(self, name, kind, more, most=6):
        scales = {"scale": self.draw.choice((1.0, 1e-4, -0.0025)), "offset": self.draw.choice((0.0, -2.5))}
        if more:
            scales["offset"] = 0.0  # its safe value must be one that can be sent
        fields = {f"{name}_{i}": self.number() | scales | more for i in range(self.draw.randint(1, most))}
        return {"rate_hz": 100.0, "fields": fields} | ({"kind": kind} if self.kind else {})

    def put(self, frame, number, value):
        size = SIZES[number["type"]]
        frame[number["at"] : number["at"] + size] = (value % (1 << 8 * size)).to_bytes(size, number["byte_order"])

    def frame(self, name, lengths, content, count=None):
        """A good frame of a message, of so many bytes in all, with `content` where nothing else is."""
        options, length = self.options.receive[name], lengths[name]
        frame = bytearray(content(length))
        frame[: len(self.sync)] = self.sync
        if self.kind:
            self.put(frame, self.kind, options.kind)
        if self.length:
            self.put(frame, self.length, length - self.length["plus"])
        if options.counter is not None and count is not None:
            self.put(frame, options.counter.model_dump(), count)
        return self.sealed(frame)

    def sealed(self, frame):
        if crc := self.options.crc:
            end = len(frame) - crc.size
            frame[end:] = crc.function(bytes(frame[crc.first : end])).to_bytes(crc.size, crc.byte_order)
        return bytes(frame)

    def pieces(self, lengths, count):
        """So many pieces of a stream."""
        draw = self.draw
        for _ in range(count):
            name, luck = draw.choice(list(self.counts)), draw.random()
            self.counts[name] += 1 if luck < 0.9 else draw.randint(0, 5)
            filling = draw.choice((draw.randbytes, draw.randbytes, bytes, lambda size: b"\xff" * size))
            frame = self.frame(name, lengths, filling, self.counts[name])
            if draw.random() < 0.8:
                yield frame
                continue
            yield draw.choice(
                (
                    draw.randbytes(draw.randint(0, 12)),
                    frame[: draw.randint(0, len(frame))],
                    self.sync + draw.randbytes(draw.randint(0, 30)),
                    flipped(frame, draw.randrange(8 * len(frame))),
                    frame[: len(frame) // 2] + frame,
                    self.sealed(bytearray(self.sync) + bytearray(draw.randbytes(len(frame) - len(self.sync)))),
                )
            )

    def chunks(self, lengths, count):
        """The same as bytes that come together."""
        whole, draw = b"".join(self.pieces(lengths, count)), self.draw
        most = draw.choice((5, 40, 400))
        while whole:
            size = draw.randint(1, most)
            yield whole[:size]
            whole = whole[size:]


def flipped(frame, bit):
    """`frame` with one wrong bit."""
    changed = bytearray(frame)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)
