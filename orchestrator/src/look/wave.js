document.querySelectorAll('.wave').forEach(root => {
  const {duration, start} = root.dataset;
  const bodies = [...root.querySelectorAll('svg')].map(svg => ({
    units: [...svg.querySelectorAll('polygon.unit')],
    data: Int32Array.from(svg.nextElementSibling.textContent.split(',')),
  }));
  const [button, range, output] = root.querySelectorAll('button, input, output');
  const count = +range.max + 1;
  let at = 0, last = null;
  const show = () => {
    const n = Math.min(Math.floor(at), count - 1);
    for (const {units, data} of bodies) units.forEach((e, u) => {
      const i = 2 * units.length + 4 * (n * units.length + u), [x, y] = data.subarray(2 * u);
      e.setAttribute('transform', `translate(${data[i] / 1e3} ${-data[i + 1] / 1e3}) rotate(${-data[i + 2] * 0.0057296} ${x / 1e3} ${y / 1e3})`);
      e.setAttribute('class', `unit s${Math.round(20 * Math.sqrt(data[i + 3] / 1e3))}`);
    });
    range.value = n;
    output.textContent = ((n + 1) * +duration / count).toFixed(3) + ' s';
  };
  const tick = now => {
    if (last === null) return;
    at += (now - last) / 8000 * count;
    last = now;
    if (at >= count) at = 0;
    show();
    requestAnimationFrame(tick);
  };
  const play = on => {
    button.textContent = on ? 'Pause' : 'Play';
    last = on ? performance.now() : null;
    if (on) requestAnimationFrame(tick);
  };
  button.onclick = () => play(last === null);
  range.oninput = () => { play(false); at = +range.value; show(); };
  at = +start;
  show();
});
