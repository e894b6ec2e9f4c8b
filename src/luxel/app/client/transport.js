// What the app needs of whatever carries its messages. Types only.

/**
 * What carries the bytes of messages: a socket, a notebook's comm, or a file that holds all there is to say.
 * @typedef {object} Transport
 * @property {() => void} open called once, when the app listens
 * @property {() => void} close no calls come after it
 * @property {(message: ArrayBuffer) => void} send dropped while there is no connection
 * @property {boolean} connected
 * @property {boolean} live whether there is a server, or a kernel, that can draw
 * @property {((message: ArrayBuffer) => void) | null} onmessage
 * @property {(() => void) | null} onopen a connection is made, perhaps anew: nothing that was said before counts any more
 * @property {((trouble: string | null, mild?: boolean) => void) | null} ontrouble what is wrong, in words; null when it no longer is
 */

export {};
