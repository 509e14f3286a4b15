// Draws the body, its dipole and its angular velocity at frame k, seen from a fixed direction.
//
// frames: attitudes (quaternions, scalar first) and ω in body axes; mesh: segments of the surface in
// body axes; lines, arrows, tips, trail: what is drawn; dipole: its direction in body axes.
const f = frames.data
const n = f.tau.length
if (n == 0) {
  lines.data = {x0: [], y0: [], x1: [], y1: [], alpha: []}
  arrows.data = {x0: [], y0: [], x1: [], y1: [], color: []}
  tips.data = {x: [], y: [], text: [], color: []}
  trail.data = {x: [], y: []}
  return
}
const azimuth = 0.6, elevation = 0.35
const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)]

// v_lab = q∘v∘q*
function to_laboratory(i, [x, y, z]) {
  const [a, b, c, d] = [f.q0[i], f.q1[i], f.q2[i], f.q3[i]]
  return [
    (a*a + b*b - c*c - d*d)*x + 2*(b*c - a*d)*y + 2*(b*d + a*c)*z,
    2*(b*c + a*d)*x + (a*a - b*b + c*c - d*d)*y + 2*(c*d - a*b)*z,
    2*(b*d - a*c)*x + 2*(c*d + a*b)*y + (a*a - b*b - c*c + d*d)*z,
  ]
}

// Horizontal, vertical, towards the eye
function seen([x, y, z]) {
  const ahead = ca*x + sa*y
  return [ca*y - sa*x, ce*z - se*ahead, ce*ahead + se*z]
}

const i = Math.min(Math.max(k, 0), n - 1)
const m = mesh.data
const drawn = {x0: [], y0: [], x1: [], y1: [], alpha: []}
for (let j = 0; j < m.x0.length; j++) {
  const p = seen(to_laboratory(i, [m.x0[j], m.y0[j], m.z0[j]]))
  const q = seen(to_laboratory(i, [m.x1[j], m.y1[j], m.z1[j]]))
  drawn.x0.push(p[0]); drawn.y0.push(p[1]); drawn.x1.push(q[0]); drawn.y1.push(q[1])
  drawn.alpha.push(p[2] + q[2] > 0 ? 0.9 : 0.2)
}
lines.data = drawn

const DIPOLE = 1.35, OMEGA = 1.5
const tip = (j) => seen(to_laboratory(j, dipole.map((x) => DIPOLE*x)))
const largest = Math.max(...f.speed)
const scale = largest > 0 ? OMEGA/largest : 0
const w = seen(to_laboratory(i, [f.w1[i]*scale, f.w2[i]*scale, f.w3[i]*scale]))
const d = tip(i)
const colors = ["#d55e00", "#0072b2"]
arrows.data = {x0: [0, 0], y0: [0, 0], x1: [d[0], w[0]], y1: [d[1], w[1]], color: colors}
tips.data = {x: [1.1*d[0], 1.1*w[0]], y: [1.1*d[1], 1.1*w[1]], text: ["d", "ω"], color: colors}
const path = {x: [], y: []}
for (let j = Math.max(0, i - 60); j <= i; j++) {
  const p = tip(j)
  path.x.push(p[0]); path.y.push(p[1])
}
trail.data = path
title.text = `the body in the laboratory, τ = ${f.tau[i].toPrecision(4)}`
