// data-login-link: the address was printed by `kilter server login`; what is behind its # logs in once, and is taken out of the
// address and so out of the history at once. Somebody presses the button: a foreign page cannot log anybody in unasked.
const form = document.querySelector("[data-login-link]");
const secret = window.location.hash.slice(1);
if (form && secret) {
  form.elements.link.value = secret;
  form.hidden = false;
  form.querySelector("button").focus();
  window.history.replaceState(null, "", window.location.pathname + window.location.search);
}
