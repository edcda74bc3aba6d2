// What is shown is in the address: #/camera/lobby, #/link/lobby%2F1/hall%2F2/unseen, #/versions/7.

export function link(...parts) {
  return `#/${parts.map(encodeURIComponent).join("/")}`;
}

export function here() {
  const parts = location.hash.replace(/^#\/?/, "").split("/").filter(Boolean);
  try {
    return parts.length ? parts.map(decodeURIComponent) : ["map"];
  } catch (error) {
    if (error instanceof URIError) return ["map"];
    throw error;
  }
}

export function go(...parts) {
  location.hash = link(...parts);
}
