// What is visible: ids read back from the screen, gathered since the camera last moved, and what to ask the server for.

/**
 * Where textures are: tiles, or baked ones.
 * @typedef {object} Store
 * @property {(id: number) => boolean} isCurrent whether it has the texture of a particle under the current light
 * @property {(id: number) => boolean} isEstimate whether a better one may come
 * @property {(id: number) => boolean} isStale whether it has one, but of another light
 * @property {number} current names that light
 * @property {number} capacity most textures
 */

const RESEND_MS = 1000;
const MOVING_MS = 150;

/** Particles seen lately: what there is time to draw while the camera moves. */
export class Recent {
  /** @param {number} count particles */
  constructor(count) {
    this.seen = new Int32Array(count).fill(-1e9); // the last sweep that found each
    this.turn = 0;
    this.found = new Int32Array(1024);
    this.count = 0;
  }

  /** Take in a sweep; what none of the last `kept` ones found is forgotten. @param {Uint32Array} data ids + 1 @param {number} stride @param {number} kept */
  collect(data, stride, kept) {
    const { seen } = this;
    const turn = ++this.turn;
    let { found } = this, count = 0;
    for (let k = 0; k < this.count; k++) if (seen[found[k]] > turn - kept) found[count++] = found[k];
    for (let k = 0; k < data.length; k += stride) {
      const id = data[k] - 1;
      if (id < 0 || id >= seen.length || seen[id] === turn) continue;
      if (seen[id] <= turn - kept) {
        if (count === found.length) {
          this.found = new Int32Array(2 * count);
          this.found.set(found);
          found = this.found;
        }
        found[count++] = id;
      }
      seen[id] = turn;
    }
    this.count = count;
  }

  get ids() {
    return this.found.subarray(0, this.count);
  }
}

export class Sight {
  /** @param {number} count particles */
  constructor(count) {
    this.stamp = new Int32Array(count).fill(-1);
    this.ids = new Int32Array(1024);
    this.count = 0;
    this.epoch = 0;
    /** Counts what came into sight, and moves of the camera. */
    this.changes = 0;
  }

  /**
   * Take in a sweep. `epoch` tells which camera it saw: the first sweep of a newer one starts the set anew.
   * @param {Uint32Array} data ids + 1 @param {number} stride @param {number} epoch
   */
  collect(data, stride, epoch) {
    if (epoch !== this.epoch) {
      this.epoch = epoch;
      this.count = 0;
      this.changes++;
    }
    const { stamp } = this;
    for (let k = 0; k < data.length; k += stride) {
      const id = data[k] - 1;
      if (id < 0 || id >= stamp.length || stamp[id] === epoch) continue;
      stamp[id] = epoch;
      if (this.count === this.ids.length) {
        const grown = new Int32Array(2 * this.count);
        grown.set(this.ids);
        this.ids = grown;
      }
      this.ids[this.count++] = id;
      this.changes++;
    }
  }

  /** @param {number} id */
  isVisible(id) {
    return this.stamp[id] === this.epoch;
  }

  /**
   * How many visible particles have their tile, how many of these are estimates, how many others have a coarse record, and how many of the rest a tile of another light.
   * @param {Store} tiles @param {import("./coarse.js").CoarseStore | null} records
   */
  litCount(tiles, records) {
    let ready = 0, estimates = 0, coarse = 0, stale = 0;
    for (let k = 0; k < this.count; k++) {
      if (tiles.isCurrent(this.ids[k])) {
        ready++;
        if (tiles.isEstimate(this.ids[k])) estimates++;
      } else if (records?.has(this.ids[k])) coarse++;
      else if (tiles.isStale(this.ids[k])) stale++;
    }
    return { ready, estimates, coarse, stale };
  }
}

/** What to ask the server for, and when, under one light. */
export class Requests {
  /** @param {Sight} sight */
  constructor(sight) {
    this.sight = sight;
    /** Particles asked for, each once a light. */
    this.count = 0;
    this.asked = new Int32Array(sight.stamp.length).fill(-1); // the light under which an id was asked for last
    this.sentAt = -Infinity;
    this.known = -1; // changes of sight that were asked about
    this.waiting = false; // for light, or for the next chance to ask for it
  }

  /**
   * Ids to ask for now, if it is time to: soon when something new came into sight, else about once a second,
   * so that the server does not take the request for outdated.
   * @param {Store} tiles @param {number} now milliseconds
   * @returns {Int32Array | null}
   */
  next(tiles, now) {
    const { sight } = this;
    if (now - this.sentAt < (this.known === sight.changes ? RESEND_MS : MOVING_MS)) {
      this.waiting = true;
      return null;
    }
    const missing = new Int32Array(sight.count);
    let n = 0;
    for (let k = 0; k < sight.count; k++) {
      const id = sight.ids[k];
      if (tiles.isCurrent(id) && !tiles.isEstimate(id)) continue;
      missing[n++] = id;
      if (this.asked[id] !== tiles.current) {
        this.asked[id] = tiles.current;
        this.count++;
      }
    }
    this.known = sight.changes;
    this.waiting = n > 0;
    if (n === 0) return null;
    this.sentAt = now;
    // What the atlas cannot hold is not asked for.
    return missing.subarray(0, Math.max(0, Math.min(n, tiles.capacity - (sight.count - n))));
  }

  /** The light changed, or the connection: ask again at once. */
  again() {
    this.sentAt = -Infinity;
    this.known = -1;
  }
}
