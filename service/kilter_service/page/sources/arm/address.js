// The state of the picture in the address: whoever opens it again, or is sent it, sees the same.
const LATER_MS = 300;

export class Address {
  constructor() {
    this.given = new URLSearchParams(window.location.search);
    this.next = 0;
  }

  get(name) {
    return this.given.get(name);
  }

  /** Note what differs from how the picture begins; null of what does not. */
  set(state) {
    for (const [name, value] of Object.entries(state)) {
      if (value === null || value === "") this.given.delete(name);
      else this.given.set(name, value);
    }
    clearTimeout(this.next);
    this.next = setTimeout(() => {
      const asked = this.given.toString().replaceAll("%2C", ",");
      window.history.replaceState(window.history.state, "", `${window.location.pathname}${asked ? `?${asked}` : ""}${window.location.hash}`);
    }, LATER_MS);
  }
}
