'use strict';
// A panel marked data-control asks the run, by the token behind # in the address that was printed; without one it stays hidden.
(() => {
  const key = 'metasense-token';
  if (location.hash.startsWith('#token=')) {
    sessionStorage.setItem(key, location.hash.slice(7));
    history.replaceState(null, '', location.pathname + location.search);
  }
  const token = sessionStorage.getItem(key), panel = document.querySelector('[data-control]');
  if (!token || !panel) return;
  const ask = async line => {
    try {
      const answer = await fetch(panel.dataset.control, {method: 'POST', headers: {Authorization: `Bearer ${token}`}, body: line});
      if (answer.status === 401) sessionStorage.removeItem(key);
      return await answer.text();
    } catch { return 'The server has ended.'; }
  };
  const state = async () => { panel.querySelector('[data-state]').textContent = await ask('state'); };
  panel.addEventListener('submit', async event => {
    event.preventDefault();
    const {count} = event.target.elements, status = panel.querySelector('[role=status]');
    status.textContent = '…';
    status.textContent = await ask(event.submitter.value + (count ? ` ${count.value}` : ''));
    state();
  });
  document.addEventListener('refreshed', state);
  panel.hidden = false;
  state();
})();
