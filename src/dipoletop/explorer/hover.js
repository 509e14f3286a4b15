// How the start under the pointer ends; known only for a finished picture.
const {x, y, dw, dh, classes, omega_inf} = ends.data
if (!x.length) return "computing …"
const [rows, columns] = omega_inf[0].shape
const column = Math.floor((special_vars.x - x[0])/dw[0]*columns)
const row = Math.floor((special_vars.y - y[0])/dh[0]*rows)
if (row < 0 || column < 0 || row >= rows || column >= columns) return "computing …"
const place = row*columns + column, name = names[classes[0][place]], omega = omega_inf[0][place]
return omega ? `${name}, ω∞ = ${Number(omega.toPrecision(4))}`.replace("-", "−") : name
