"""What the pictures of a page show, in the units of their axes."""

import base64

import numpy as np

# From here on the page notes what is drawn with Plot, by the canvas: its marks and ticks.
NOTE = """() => {
    window.seen = {}
    const context = CanvasRenderingContext2D.prototype
    const name_of = ({ canvas }) => canvas.id || canvas.ariaLabel
    const { reset, fillText } = context
    context.reset = function () {
        seen[name_of(this)] = { marks: [], ticks: [] }
        reset.call(this)
    }
    context.fillText = function (...tick) {
        seen[name_of(this)].ticks.push(tick)
        fillText.apply(this, tick)
    }
    const list = (n, of) => Float64Array.from({ length: n }, (_, k) => of(k))
    const note = (kind, what) => {
        const draw = Plot.prototype[kind]
        Plot.prototype[kind] = function (...given) {
            const picture = seen[name_of(this.c)]
            picture.plot = this
            picture.marks.push({ kind, ...what(...given) })
            draw.apply(this, given)
        }
    }
    for (const kind of ["line", "area", "dots"])
        note(kind, (n, x, y, colour, look) =>
            ({ colour, label: look?.label ?? "", columns: [x, y].map(of => list(n, of)) }))
    note("soil", ([wide, high], corner, cell_m, traction) => {
        const place = at => [Math.floor(at / high), at % high]
        const along = axis => list(wide * high, at => corner[axis] + cell_m * place(at)[axis])
        const kappa = list(wide * high, at => traction(...place(at)))
        return { colour: "", label: "", columns: [along(0), along(1), kappa] }
    })
    window.bytes = array => {
        let text = ""
        for (const byte of new Uint8Array(Float64Array.from(array).buffer))
            text += String.fromCharCode(byte)
        return btoa(text)
    }
}"""
SEEN = """() => Object.fromEntries(Object.entries(seen).map(([canvas, { plot, marks }]) => {
    const [left, top, right, bottom] = plot.box
    const at = (offsetX, offsetY) => plot.data({ offsetX, offsetY })
    const all = marks.map(mark => ({ ...mark, columns: mark.columns.map(bytes) }))
    return [canvas, { all, limits: [at(left, bottom), at(right, top)] }]
}))"""


def floats(text):
    """The array behind a text."""
    return np.frombuffer(base64.b64decode(text))


class Marks:
    """What a picture shows, and where its axes begin and end."""

    def __init__(self, all, limits):
        self.all = [
            (
                mark["kind"],
                mark["colour"],
                mark["label"],
                np.transpose([*map(floats, mark["columns"])]),
            )
            for mark in all
        ]
        self.low, self.high = np.array(limits)

    def of(self, kind, colour=""):
        """The points (n, 2) of each mark without a label; of soil (n, 3), with its traction."""
        return [points for *what, points in self.all if what == [kind, colour, ""]]

    def labelled(self, label):
        """The points of the line with this label."""
        (points,) = [points for _, _, of, points in self.all if of == label]
        return points

    def has_room_for(self, points):
        return ((self.low - 1e-9 <= points) & (points <= self.high + 1e-9)).all()


def marks_on(page):
    """{picture: its Marks}, by the name of its canvas."""
    return {canvas: Marks(**seen) for canvas, seen in page.evaluate(SEEN).items()}


PLACE = """([picture, x, y]) => {
    const { plot } = seen[picture]
    const box = plot.c.canvas.getBoundingClientRect()
    return [box.x + plot.x(x), box.y + plot.y(y)]
}"""


def place_on(page, picture, x, y):
    """Where (x, y) of a picture's axes is on the page [px]."""
    return page.evaluate(PLACE, [picture, x, y])
