// A pressed button moves its slider there and back again, until it is released.
play.label = play.active ? "❚❚" : "▶"
window.clearInterval(play.dt_timer)
let way = 1
if (play.active) play.dt_timer = window.setInterval(() => {
  const next = slider.value + way*slider.step
  if (next >= slider.end) way = -1
  if (next <= slider.start) way = 1
  slider.value = Math.min(slider.end, Math.max(slider.start, next))
}, 80)
