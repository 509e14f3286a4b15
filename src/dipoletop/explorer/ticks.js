// Labels of the ticks of an axis: multiples of π for an angle, else few digits.
// If all ticks of an axis begin with the same digits, only the first one shows them.
const step = Math.abs(ticks[1] - ticks[0]), most = Math.max(...ticks.map(Math.abs))
if (of_angle && step > 0.3) {
  const eighths = Math.round(tick/(Math.PI/4))
  if (Math.abs(tick - eighths*Math.PI/4) < 1e-9) {
    const [over, under] = eighths % 4 == 0 ? [eighths/4, 1]
      : eighths % 2 == 0 ? [eighths/2, 2] : [eighths, 4]
    const above = over == 0 ? "0" : over == 1 ? "π" : over == -1 ? "−π" : `${over}π`
    return (over == 0 || under == 1 ? above : `${above}/${under}`).replace("-", "−")
  }
}
if (!(step < 1e-4*most)) return String(Number(tick.toPrecision(5))).replace("-", "−")
if (index == 0) return tick.toPrecision(Math.min(17, Math.ceil(Math.log10(most/step)) + 1))
return "+" + Number((tick - ticks[0]).toPrecision(2)).toExponential().replace("-", "−")
