// A button and a slider over frames, of which `show` draws one, between two of them too, and says what it is.
const player = (root, seconds, show) => {
  const [button, range, output] = root.querySelectorAll('button, input, output');
  let at = 0, last = null;
  const put = to => {
    at = to;
    range.value = Math.floor(at);
    output.textContent = show(at);
    range.setAttribute('aria-valuetext', output.textContent);
  };
  const tick = now => {
    if (last === null) return;
    const count = +range.max + 1, to = at + (now - last) / 1000 / seconds * count;
    last = now;
    put(to < count ? to : 0);
    requestAnimationFrame(tick);
  };
  const play = on => {
    button.textContent = on ? 'Pause' : 'Play';
    last = on ? performance.now() : null;
    if (on) requestAnimationFrame(tick);
  };
  button.onclick = () => play(last === null);
  range.oninput = () => { play(false); put(+range.value); };
  return put;
};
document.querySelectorAll('.wave').forEach(root => {
  const {duration, start} = root.dataset;
  const bodies = [...root.querySelectorAll('svg')].map(svg => ({
    units: [...svg.querySelectorAll('polygon.unit')],
    data: Int32Array.from(svg.nextElementSibling.textContent.split(',')),
  }));
  const count = +root.querySelector('input').max + 1;
  player(root, 8, at => {
    const n = Math.floor(at);
    for (const {units, data} of bodies) units.forEach((e, u) => {
      const i = 2 * units.length + 4 * (n * units.length + u), [x, y] = data.subarray(2 * u);
      e.setAttribute('transform', `translate(${data[i] / 1e3} ${-data[i + 1] / 1e3}) rotate(${-data[i + 2] * 0.0057296} ${x / 1e3} ${y / 1e3})`);
      e.setAttribute('class', `unit s${Math.round(20 * Math.sqrt(data[i + 3] / 1e3))}`);
    });
    return ((n + 1) * +duration / count).toFixed(3) + ' s';
  })(+start);
});
document.querySelectorAll('.course').forEach(root => {
  const [units, ligaments, marks] = ['polygon.unit', 'path.ligament', '.panel, .sensor'].map(of => [...root.querySelectorAll(of)]);
  const range = root.querySelector('input');
  const first = [0]; // corner of each unit
  units.forEach(e => first.push(first.at(-1) + e.points.numberOfItems));
  let joints, designs;
  const read = () => {
    [joints, ...designs] = root.querySelector('[data-live]').textContent.split('\n').map(line => line.split(',').map(Number));
    range.max = designs.length - 1;
  };
  const put = player(root, 5, at => {
    const n = Math.floor(at), [step, ...from] = designs[n], to = (designs[n + 1] ?? designs[n]).slice(1);
    const number = i => (from[i] + (at - n) * (to[i] - from[i])).toFixed(3);
    const point = i => `${number(2 * i)} ${number(2 * i + 1)}`;
    units.forEach((e, u) => e.setAttribute('points', Array.from({length: first[u + 1] - first[u]}, (_, c) => point(first[u] + c)).join(' ')));
    ligaments.forEach((e, l) => e.setAttribute('d', `M${point(joints[2 * l])}L${point(joints[2 * l + 1])}`));
    marks.forEach((e, m) => e.setAttribute('transform', `translate(${point(first.at(-1) + m)})`));
    return `step ${step} of ${root.dataset.steps}`;
  });
  const go = () => {
    const latest = !designs || range.value === range.max;
    read();
    put(latest ? +range.max : +range.value);
  };
  document.addEventListener('refreshed', go);
  go();
});
