//! Which files a node reads, and where it publishes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::diag::{Diagnostic, Diagnostics, Span, did_you_mean};
use crate::op::Source;
use crate::spec::{Val, folder_of, why};

/// What a node reads.
#[derive(Default)]
pub struct Found {
    pub files: Vec<PathBuf>,
    /// Of each file its name beside another.
    pub beside: Vec<Option<String>>,
    pub globs: Vec<PathBuf>,
}

impl Found {
    /// A file, and those beside it.
    fn push(&mut self, path: PathBuf, beside: fn(&Source) -> Vec<String>) {
        let folder = path.parent().unwrap_or(Path::new("")).to_path_buf();
        let mut names: Vec<String> = Vec::new();
        let mut more = beside(&Source::of_file(&path, None));
        self.files.push(path);
        self.beside.push(None);
        while !more.is_empty() {
            let mut next = Vec::new();
            for name in more {
                if names.len() == MOST_BESIDE || names.contains(&name) {
                    continue;
                }
                let path = folder.join(&name);
                if path.is_file() {
                    next.extend(beside(&Source::of_file(&path, Some(&name))));
                    self.files.push(path);
                    self.beside.push(Some(name.clone()));
                } else {
                    self.globs.push(PathBuf::from(glob::Pattern::escape(&path.to_string_lossy())));
                }
                names.push(name);
            }
            more = next;
        }
    }
}

/// Files beside one: more are not looked for.
const MOST_BESIDE: usize = 4096;

/// Files of one `x-file` parameter, in order; globs in byte order, their patterns noted; each with those beside it.
pub fn inputs(name: &str, value: &Val, beside: fn(&Source) -> Vec<String>, found: &mut Found, wrong: &mut Diagnostics) {
    let all = value.list().unwrap_or(std::slice::from_ref(value));
    if all.is_empty() {
        let d = Diagnostic::error("missing-file", format!("`{name}` names no file"));
        wrong.push(d.at(value.span.clone()).value(value.written()));
    }
    for value in all {
        let Some(text) = value.text() else { continue };
        let folder = folder_of(&value.origin);
        let path = folder.join(text);
        let shown = Path::new(&value.origin.name).parent().unwrap_or(Path::new("")).join(text);
        let shown = shown.display();
        let mut say = |code, sentence: String| {
            wrong.push(Diagnostic::error(code, sentence).at(value.span.clone()).value(value.written()));
        };
        if text.is_empty() {
            say("missing-file", format!("`{name}` is empty"));
            continue;
        }
        match path.metadata() {
            Ok(m) if m.is_dir() => say("missing-file", format!("`{name}`: {shown} is a folder")),
            Ok(m) if !m.is_file() => say("missing-file", format!("`{name}`: {shown} is no regular file")),
            Ok(_) => found.push(path, beside),
            Err(_) if text.contains(['*', '?', '[']) => {
                let pattern = pattern(&folder, text);
                match expand(&pattern) {
                    Ok(paths) if paths.is_empty() => {
                        say("missing-file", format!("`{name}`: no file matches {shown}"));
                    }
                    Ok(paths) => paths.into_iter().for_each(|path| found.push(path, beside)),
                    Err(e) => say("missing-file", format!("`{name}`: {shown}: {e}")),
                }
                found.globs.push(pattern);
            }
            Err(e) => {
                let sentence = format!("`{name}`: cannot read {shown}: {}", why(&e));
                let d = Diagnostic::error("missing-file", sentence).at(value.span.clone()).value(value.written());
                wrong.push(match meant(&path, text) {
                    Some(help) => d.help(help),
                    None => d,
                });
            }
        }
    }
}

/// What to do about a file that is not there.
fn meant(path: &Path, text: &str) -> Option<String> {
    if text.starts_with("https://") || text.starts_with("http://") {
        return Some("lodge reads files only: fetch it first".into());
    }
    if text.starts_with("~/") {
        return Some("`~` stands for no folder here: write the whole path".into());
    }
    if text.contains('\\') && !cfg!(windows) {
        return Some("write `/` between folders".into());
    }
    let entries = std::fs::read_dir(path.parent()?).ok()?.take(MOST_BESIDE).flatten();
    let mut names: Vec<String> = entries.filter_map(|e| e.file_name().into_string().ok()).collect();
    names.sort();
    let near = did_you_mean(path.file_name()?.to_str()?, names.iter().map(|n| &**n))?;
    Some(format!("did you mean `{}`?", Path::new(text).with_file_name(near).display()))
}

fn pattern(folder: &Path, text: &str) -> PathBuf {
    if Path::new(text).is_absolute() {
        return PathBuf::from(text);
    }
    PathBuf::from(glob::Pattern::escape(&folder.to_string_lossy())).join(text)
}

/// The files that match a pattern of [`Node::globs`](super::Node::globs), by bytes of their paths. `*` stops at `/`
/// and does not match a leading dot.
pub fn expand(pattern: &Path) -> Result<Vec<PathBuf>, String> {
    let options =
        glob::MatchOptions { case_sensitive: true, require_literal_separator: true, require_literal_leading_dot: true };
    let paths = glob::glob_with(&pattern.to_string_lossy(), options)
        .map_err(|e| format!("the pattern is broken: {}", e.msg))?;
    let mut out = Vec::new();
    for path in paths {
        let path = path.map_err(|e| format!("cannot read {}: {}", e.path().display(), why(e.error())))?;
        match std::fs::metadata(&path) {
            Ok(meta) if meta.is_file() => out.push(path),
            Ok(meta) if meta.is_dir() => {}
            Ok(_) => return Err(format!("{} is no regular file", path.display())),
            Err(e) => return Err(format!("cannot read {}: {}", path.display(), why(&e))),
        }
    }
    out.sort_by(|a, b| a.as_os_str().as_encoded_bytes().cmp(b.as_os_str().as_encoded_bytes()));
    Ok(out)
}

/// A published path in its one form: relative, parts joined by `/`.
pub fn output(text: &str) -> Result<String, &'static str> {
    if text.starts_with('/') || Path::new(text).is_absolute() {
        return Err("must be relative: it lies in the output folder");
    }
    if text.contains(|c: char| c.is_control() || c == '\\') {
        return Err("must not hold control characters or `\\`");
    }
    let parts: Vec<_> = text.split('/').filter(|p| !p.is_empty() && *p != ".").collect();
    if parts.contains(&"..") {
        return Err("must not leave the output folder");
    }
    if parts.is_empty() { Err("names no file") } else { Ok(parts.join("/")) }
}

/// Something that is published.
pub struct Published<'a> {
    pub path: &'a str,
    /// The node, with and without its variant.
    pub node: &'a str,
    pub base: &'a str,
    pub span: &'a Span,
}

/// No two nodes may publish the same file, one into the other's folder, or names that differ only in case.
pub fn clashes(all: &[Published], wrong: &mut Diagnostics) {
    let mut taken: BTreeMap<String, usize> = BTreeMap::new();
    let mut said: Vec<(&str, &str)> = Vec::new();
    for (i, new) in all.iter().enumerate() {
        let key = new.path.to_lowercase();
        let above = key.match_indices('/').find_map(|(at, _)| taken.get(&key[..at]));
        let inside = format!("{key}/");
        let below = || taken.range(inside.clone()..).next().filter(|(k, _)| k.starts_with(&inside)).map(|(_, i)| i);
        if let Some(&old) = taken.get(&key).or(above).or_else(below) {
            let old = &all[old];
            if said.contains(&(old.base, new.base)) {
                continue;
            }
            said.push((old.base, new.base));
            let sentence = if old.path == new.path {
                format!("`{}` and `{}` both publish `{}`", old.node, new.node, new.path)
            } else if old.path.to_lowercase() == key {
                format!(
                    "`{}` publishes `{}` and `{}` publishes `{}`: they differ only in case",
                    old.node, old.path, new.node, new.path
                )
            } else {
                format!(
                    "`{}` publishes `{}` and `{}` publishes `{}`: one lies inside the other",
                    old.node, old.path, new.node, new.path
                )
            };
            let d = Diagnostic::error("same-output", sentence).at(new.span.clone()).node(new.base).value(new.path);
            let axis =
                new.node.strip_prefix(new.base).and_then(|v| v.strip_prefix('[')).and_then(|v| v.split('=').next());
            wrong.push(match axis {
                Some(axis) if old.base == new.base => d.help(format!("put `${{{axis}}}` in the path")),
                _ => d,
            });
        } else {
            taken.insert(key, i);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_paths_have_one_form() {
        assert_eq!(output("./a//b.glb"), Ok("a/b.glb".into()));
        assert_eq!(output("tiles/"), Ok("tiles".into()));
        for bad in ["", ".", "/a", "../a", "a/../b", "a\\b", "a\nb"] {
            assert!(output(bad).is_err(), "{bad:?}");
        }
    }
}
