'use strict';
// Parts of a page marked data-live are put in their places again when the server says that something has changed.
(() => {
  const {events, generation} = document.body.dataset;
  document.querySelectorAll('textarea[data-ask]').forEach(text => text.addEventListener('keydown', event => {
    if (event.key === 'Enter' && (event.ctrlKey || event.metaKey)) text.form.requestSubmit();
  }));
  if (!events) return;
  let seen = generation, wanted = generation, busy = false, source = null;
  const hold = document.querySelector('#hold');
  const swap = page => document.querySelectorAll('[data-live]').forEach(old => {
    const fresh = page.getElementById(old.id);
    if (!fresh || fresh.innerHTML === old.innerHTML) return;
    const scrolled = [...old.querySelectorAll('.scroll')].map(e => [e.scrollLeft, e.scrollTop]);
    const ticked = [...old.querySelectorAll(':checked')].map(e => e.value);
    const focus = old.contains(document.activeElement) && document.activeElement.getAttribute('href');
    old.replaceChildren(...fresh.childNodes);
    old.querySelectorAll('.scroll').forEach((e, i) => scrolled[i] && e.scrollTo(...scrolled[i]));
    old.querySelectorAll('[type=checkbox]').forEach(e => { e.checked = ticked.includes(e.value); });
    if (focus) [...old.querySelectorAll('a')].find(a => a.getAttribute('href') === focus)?.focus({preventScroll: true});
  });
  const refresh = async () => {
    if (busy || seen === wanted) return;
    busy = true;
    const begun = performance.now();
    try {
      const answer = await fetch(location.href);
      if (answer.ok) {
        const page = new DOMParser().parseFromString(await answer.text(), 'text/html');
        seen = page.body.dataset.generation;
        swap(page);
        document.body.dataset.generation = seen;
        document.dispatchEvent(new Event('refreshed'));
      }
    } catch { /* the server has ended: the last state stays */ }
    // a page that costs much is asked for less often
    const rest = Math.min(2 * (performance.now() - begun), 30000);
    setTimeout(() => { busy = false; if (source) refresh(); }, rest);
  };
  const follow = () => {
    const on = !document.hidden && hold.getAttribute('aria-pressed') === 'false';
    if (on && !source) {
      source = new EventSource(events);
      source.onmessage = event => { wanted = event.data; refresh(); };
    } else if (!on && source) {
      source.close();
      source = null;
    }
  };
  hold.hidden = false;
  hold.onclick = () => {
    hold.setAttribute('aria-pressed', hold.getAttribute('aria-pressed') === 'false');
    follow();
  };
  document.addEventListener('visibilitychange', follow);
  follow();
})();
