//! insta's file format: a YAML header between two lines `---`, then the contents. Keys in insta's order, ours under
//! `info`: it would lose any other when it accepts a file.

use std::fmt::Write;

/// One snapshot, of text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snap {
    pub source: String,
    pub description: String,
    pub expression: String,
    /// In the order of the file.
    pub info: Vec<(String, String)>,
    /// Without trailing white space.
    pub contents: String,
}

impl Snap {
    pub fn info(&self, key: &str) -> Option<&str> {
        self.info.iter().find(|(k, _)| k == key).map(|(_, v)| &v[..])
    }

    pub fn to_text(&self) -> String {
        let mut out = "---\n".to_string();
        for (key, value) in
            [("source", &self.source), ("description", &self.description), ("expression", &self.expression)]
        {
            if !value.is_empty() {
                writeln!(out, "{key}: {}", quoted(value)).expect("a string grows");
            }
        }
        if !self.info.is_empty() {
            out += "info:\n";
        }
        for (key, value) in &self.info {
            let number = value.parse().is_ok_and(|n: f64| n.is_finite() && n.to_string() == *value);
            let value = if number { value.clone() } else { quoted(value) };
            writeln!(out, "  {key}: {value}").expect("a string grows");
        }
        out + "---\n" + self.contents.trim_end() + "\n"
    }

    /// Reads what [`Snap::to_text`] or insta wrote. What is not understood is left out: the file is only compared.
    pub fn parse(text: &str) -> Self {
        let text = text.replace("\r\n", "\n");
        let mut out = Self::default();
        let Some(rest) = text.strip_prefix("---\n") else { return Self { contents: text, ..out } };
        let (header, contents) = match rest.strip_prefix("---\n") {
            Some(contents) => ("", contents),
            None => rest.split_once("\n---\n").unwrap_or((rest, "")),
        };
        out.contents = contents.trim_end().to_string();
        for line in header.lines() {
            let Some((key, value)) = line.split_once(':') else { continue };
            let value = unquoted(value.trim_matches(' '));
            match key {
                "source" => out.source = value,
                "description" => out.description = value,
                "expression" => out.expression = value,
                _ => {
                    if let Some(key) = key.strip_prefix("  ") {
                        out.info.push((key.to_string(), value));
                    }
                }
            }
        }
        out
    }
}

/// A YAML string as insta writes it: plain where nothing in it means something, else in double quotes.
fn quoted(text: &str) -> String {
    // In small letters, in capitals, or with one.
    let means = |word: &str| {
        let first = word[..1].to_uppercase() + &word[1..];
        text == word || text == word.to_uppercase() || text == first
    };
    let words = ["yes", "no", "true", "false", "on", "off", "null", "~"];
    let plain = !text.is_empty()
        && !text.starts_with(' ')
        && !text.ends_with(' ')
        && text.parse::<f64>().is_err()
        && !text.starts_with(['&', '*', '?', '|', '-', '<', '>', '=', '!', '%', '@', '.'])
        && !text.starts_with("0x")
        && !text.contains([':', '{', '}', '[', ']', ',', '#', '`', '"', '\'', '\\'])
        && !text.contains(char::is_control)
        && !words.iter().any(|w| means(w));
    if plain { text.to_string() } else { serde_json::Value::from(text).to_string() }
}

fn unquoted(value: &str) -> String {
    let text = value.starts_with('"').then(|| serde_json::from_str(value).ok()).flatten();
    text.unwrap_or_else(|| value.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn through_insta(snap: &Snap) -> (insta::Snapshot, String) {
        let folder = tempfile::tempdir().unwrap();
        let [ours, theirs] = ["ours.snap", "theirs.snap"].map(|n| folder.path().join(n));
        std::fs::write(&ours, snap.to_text()).unwrap();
        let read = insta::Snapshot::from_file(&ours).unwrap();
        read.save(&theirs).unwrap();
        (read, std::fs::read_to_string(theirs).unwrap())
    }

    #[test]
    fn a_file_of_ours() {
        let snap = Snap {
            source: "town.toml".into(),
            description: "Hulls by cut".into(),
            expression: "lodge show town.toml cut[n=3]".into(),
            info: vec![("digest".into(), "12e4".into()), ("absolute".into(), 1e-6.to_string())],
            contents: "Hulls\nclusters: 3".into(),
        };
        let text = "---\nsource: town.toml\ndescription: Hulls by cut\nexpression: \"lodge show town.toml cut[n=3]\"\n\
                    info:\n  digest: \"12e4\"\n  absolute: 0.000001\n---\nHulls\nclusters: 3\n";
        assert_eq!(snap.to_text(), text);
        assert_eq!(Snap::parse(text), snap);
        assert_eq!(Snap::parse(&text.replace('\n', "\r\n")), snap);
        assert_eq!(through_insta(&snap).1, text);
        for odd in ["", "---", "---\n---\n", "no header\n", "---\nsource", "---\ninfo:\n  a\n---\n"] {
            Snap::parse(odd);
        }
    }

    fn words() -> impl Strategy<Value = String> {
        prop_oneof![
            "[ -~]{0,20}",
            "[a-z0-9\\[\\]=,. ~-]{1,12}",
            "[0-9a-f]{1,8}",
            "\\PC{0,10}",
            Just("Null".to_string()),
            Just("1.0".to_string()),
            Just("~".to_string()),
            (-1e9..1e9f64).prop_map(|v| v.to_string()),
        ]
    }

    proptest! {
        // What we write, insta reads; what it writes of that, is our bytes; what it holds equal, we do.
        #[test]
        fn insta_reads_ours_and_writes_the_same(
            source in words(), description in words(), expression in words(), info in words(),
            contents in "([ -~]{0,12}\n?){0,6}",
        ) {
            let snap = Snap {
                source, description, expression,
                info: vec![("key".into(), info), ("digest".into(), "aa".into())],
                contents: contents.trim_end().to_string(),
            };
            let (read, again) = through_insta(&snap);
            prop_assert_eq!(&again, &snap.to_text());
            prop_assert_eq!(read.metadata().source().unwrap_or_default(), &snap.source);
            prop_assert_eq!(read.as_text().unwrap().to_string(), snap.contents.as_str());
            prop_assert_eq!(Snap::parse(&again), snap);
        }
    }
}
