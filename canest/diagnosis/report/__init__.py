"""What a diagnosis writes: JSON, revised config, HTML page, sentences."""
